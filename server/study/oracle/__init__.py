"""An upper bound for all policies, computed from the link of the whole play."""
