"""What this server adds to aiohttp: limits of connections, errors as JSON, contents with tags."""
