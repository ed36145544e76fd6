"""Links: how long bytes take to pass, from traces or made up."""
