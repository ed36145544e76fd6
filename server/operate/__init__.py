"""What an operator needs around the server: load, limits, addresses, figures, settings."""
