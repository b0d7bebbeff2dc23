"""STATE: the Kalman filter that turns samples into a belief about the pack."""
