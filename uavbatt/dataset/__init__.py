"""The discharge data set: a folder of bench tests, read and checked, and its tables of repeated runs."""

from uavbatt.dataset.folder import TEMPLATE_FILES, load, write_template
from uavbatt.dataset.levels import QUANTITIES, Levels, levels, whole_minutes
from uavbatt.dataset.records import Array, DataSet, Flag, Run, Uncertainty

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
