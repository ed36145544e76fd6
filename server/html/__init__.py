"""Pages for people, as text: no request and no response is known here."""
