"""How a play went: its journal, its report, pictures of it, and the times of its stages."""
