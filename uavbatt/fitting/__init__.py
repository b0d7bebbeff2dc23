"""Battery and vehicle files from bench tests and flights; the only place where an optimiser runs."""
