"""Battery and vehicle files are fitted here to bench tests and flights."""
