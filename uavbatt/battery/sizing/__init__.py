"""The size of a pack: what is stated of it, by whom, and whether it can be."""
