"""The discharge data set: a folder of bench tests, read and checked, and its tables of repeated runs."""

from uavbatt.dataset.folder import TEMPLATE_FILES, load, write_template
from uavbatt.dataset.records import Array, DataSet, Flag, Run, Uncertainty
from uavbatt.dataset.repeated_runs import QUANTITIES, Levels, levels, whole_minutes

__all__ = [
    "QUANTITIES",
    "TEMPLATE_FILES",
    "Array",
    "DataSet",
    "Flag",
    "Levels",
    "Run",
    "Uncertainty",
    "levels",
    "load",
    "whole_minutes",
    "write_template",
]
