"""Notices: sentences for the user (warnings, and reasons why there is no number) that know what kind they are.

A notice is text: it is shown, written and compared as it is. A program that chooses between notices asks `kind_of`
and never looks for words in the text.
"""

from __future__ import annotations

from enum import Enum, auto


class Kind(Enum):
    """A kind says what a notice is about, for programs that choose between notices."""

    OTHER = auto()
    # A statement about the pack does not fit.
    CELLS_NOT_STATED = auto()
    CELLS_OF_VEHICLE = auto()
    CELLS = auto()
    NEARLY_EMPTY = auto()
    TOO_FULL = auto()
    CAPACITY_NOT_STATED = auto()
    CAPACITY_OF_VEHICLE = auto()
    CAPACITY = auto()
    CRITICAL_VOLTAGE = auto()
    LOW_VOLTAGE = auto()
    CUTOFF = auto()
    CHARGING = auto()
    SLOW_ROWS = auto()
    POWER = auto()
    UNCERTIFIED = auto()
    # Readings and belief do not fit each other.
    STUCK_VOLTAGE = auto()
    STUCK_CURRENT = auto()
    DEAD_CURRENT = auto()
    FELL_ALONE = auto()
    ROSE_ALONE = auto()
    TWO_BATTERIES = auto()
    COARSE = auto()
    UNFITTING = auto()
    FAR_OFF = auto()
    SMALL_PACK = auto()
    LARGE_PACK = auto()
    MANY_OHMS = auto()
    # A row lacks something, or the filter does.
    NO_VOLTAGE = auto()
    NO_CURRENT = auto()
    NO_TEMPERATURE = auto()
    TIME_BACKWARDS = auto()
    SETTLING = auto()
    NO_CHARGE = auto()
    NO_BELIEF = auto()
    # What a forecast says, or why there is none.
    NOT_FLYING = auto()
    NO_LOAD_ALOFT = auto()
    JUST_TAKEN_OFF = auto()
    BEYOND_SIX_HOURS = auto()
    NO_END = auto()
    FALLS_FASTER = auto()
    ENDS_SOON = auto()
    MAY_END_SOON = auto()
    ALARM = auto()
    TURN_BACK = auto()
    MAY_NOT_LAND = auto()
    ACTS_SOON = auto()
    # The link to the vehicle, and several batteries on it.
    NO_TELEMETRY = auto()
    LATE = auto()
    TWO_SENDERS = auto()
    GIVES_NOTHING = auto()
    FAULT = auto()


class Notice(str):
    """Notice is a sentence for the user with its kind."""

    kind: Kind

    def __new__(cls, words: str, kind: Kind) -> Notice:
        """Return the sentence `words` as a notice of this kind."""
        made = super().__new__(cls, words)
        made.kind = kind
        return made

    def __getnewargs__(self) -> tuple[str, Kind]:  # type: ignore[override]  # str has one argument fewer
        """Return the arguments from which a copy is made in another process."""
        return str(self), self.kind


def kind_of(words: str) -> Kind:
    """Return the kind of a notice; `OTHER` for a text that is none."""
    return words.kind if isinstance(words, Notice) else Kind.OTHER
