"""What a stream is worth against its capture: scores, tables, pictures."""
