"""What a diagnosis can say."""

from enum import Enum


class Verdict(Enum):
    """The value is what a person should read; the name in lower case is what a program reads."""

    EXPLAINED = "The model explains these runs: what is left is noise."
    EFFECT_MISSING = "An effect is missing, and these runs name it."
    CANNOT_TELL_APART = "Something is missing, and these runs cannot tell which of several effects it is."
    UNKNOWN_EFFECT = "Something is missing, and nothing in the catalogue explains it."

    @property
    def key(self) -> str:
        """Name in files."""
        return self.name.lower()
