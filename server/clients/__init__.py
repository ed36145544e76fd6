"""The limits of one client around aiohttp: connections, time, and bytes that wait."""
