"""The policies that ours is compared with. Each is one file."""
