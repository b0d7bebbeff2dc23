"""One file a log format: bytes of a flight log become rows, and rows become bytes again."""
