"""Route and place: position, mission and mode of the aircraft, from an autopilot, its log or a mission file."""
