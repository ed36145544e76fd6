"""HTTP/1.1 for one server: one strict grammar, and bytes that leave from where they lie."""
