"""Pictures as training asks for them: scaled, kept, read ahead."""
