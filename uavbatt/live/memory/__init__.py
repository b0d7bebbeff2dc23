"""Memory: what live keeps beyond its own end: the state of the batteries, and flights for the pack ledger."""
