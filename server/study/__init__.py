"""The laboratory (swings-abr): policies compared over throughput traces, in virtual time."""
