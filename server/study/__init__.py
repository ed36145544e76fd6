"""Policies compared over throughput traces, in virtual time (swings-abr)."""
