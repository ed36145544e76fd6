"""Which slots go on as they are, what leaves the trainer, and how one training follows another."""
