"""FUTURE: the load to come, and from the belief about the pack to the time that remains."""
