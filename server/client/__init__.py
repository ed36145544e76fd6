"""One client: its connection, and what is known of it while it plays and soon after."""
