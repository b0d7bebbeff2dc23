"""uavbatt: how long a drone can keep flying, how sure that is, and why it can be trusted."""
