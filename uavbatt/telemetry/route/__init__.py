"""Route and place: what an autopilot, its log or a mission file says of where the aircraft is and what it will fly."""
