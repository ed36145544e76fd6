"""The commands of swings-stream on whole streams: sum up, check, draw, edit, export."""
