"""Requests and responses as values: conditions, ranges and tags, without sockets."""
