"""The load to come where no route tells it: learned from past flights, stated, or as flown so far."""
