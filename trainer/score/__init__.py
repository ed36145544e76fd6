"""The quality of a stream against its capture: scores, tables, pictures."""
