"""What each URL gives."""
