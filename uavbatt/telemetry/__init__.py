"""IN: flight logs of any kind become a `Flight`, and live frames become rows; heavy imports wait until they are used.

a log    read -> formats/ (one file a format) -> builder, or columns for big logs -> `Flight`
a link   link/ (who speaks, who is believed) -> rows of the followed vehicle
both     parameters, identity (what the vehicle states), route/ (mission and place), cleaning/ (before the filter)
after    quality/ (charge drawn, trust in a replay), join (several batteries as one pack)
"""

from uavbatt.telemetry.read import read_log

__all__ = ["read_log"]
