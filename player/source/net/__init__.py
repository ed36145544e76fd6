"""HTTP for one play: requests, patience, where a stranger may lead, what is kept on disk."""
