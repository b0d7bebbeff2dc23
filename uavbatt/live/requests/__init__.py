"""Requests: what live asks of an autopilot, if the crew allows it: parameters, messages, the mission."""
