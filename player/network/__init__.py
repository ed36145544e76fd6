"""Files and answers from hosts that may fail, stall, lie or vanish."""
