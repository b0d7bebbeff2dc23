"""The score: forecasts of this project and of open autopilots against flights whose end is known.

`data` finds the measured data, `lines` turns a replay into forecast lines, `m100`, `truth` and `shared` each fill a
section with tables, `table` prints them.
"""
