"""A kind of problem that a file can state: its sections, and the function that makes the problem."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, is_dataclass
from typing import Any

from perilune.core import Key, PeriluneError, record, record_keys, require_type, unknown_name
from perilune.problem import Problem, Tolerance

PROOF = "proof"  # the section that is no part of the problem


@record("problem")
class Undecided:
    """Section ``problem`` of a kind that leaves nothing to choose."""


@dataclass(frozen=True, kw_only=True)
class Section:
    """A section of a file.

    Parameters
    ----------
    record
        Class of its record.
    required
        Whether it must be there.
    otherwise
        Its record where it is left out.
    known
        Records that may be stated only by their name.
    instead
        Class of another record that the section may state.
    absent
        When it may be left out, in words.
    """

    record: type
    required: bool = True
    otherwise: Any = None
    known: Mapping[str, Any] = field(default_factory=dict)
    instead: type | None = None
    absent: str = "may be left out"

    def __post_init__(self) -> None:
        """Refuse what declares no keys."""
        for stated in (self.record, self.instead):
            if stated is not None and not (isinstance(stated, type) and is_dataclass(stated)):
                raise PeriluneError(
                    "a section is stated by a record", got=repr(stated)[:80], expected="a class below @record(...)"
                )

    @property
    def keys(self) -> Mapping[str, Key]:
        """Return all keys that the section may have, in order."""
        return {**record_keys(self.record), **self._others}

    @property
    def _others(self) -> Mapping[str, Key]:
        return {} if self.instead is None else record_keys(self.instead)

    @property
    def alone(self) -> tuple[str, ...]:
        """Keys that stand in place of the others."""
        return (
            *(("name",) if self.known else ()),
            *(key for key in self._others if key not in record_keys(self.record)),
        )

    def stated(self, keys: Iterable[str]) -> type:
        """Class of the record that has these keys; where no one class has them all, of the first."""
        found = set(keys)
        return self.instead if self.instead and found and found <= self._others.keys() else self.record


@dataclass(frozen=True, kw_only=True)
class Kind:
    """Kind of problem that a file can state.

    Parameters
    ----------
    name, about
        ``problem.kind``, and what it is.
    sections
        Those of the problem by name, in the order of a file.
    make
        Called with the record of each section by the section's name.
    example
        Values that together are a problem worth solving, where they differ from the examples of the records; a key or
        a section that may be left out is shown in the template as one to be used if it is here.
    package
        Which package brings it, as is found where it is loaded; "" of perilune's own.
    """

    name: str
    about: str
    sections: Mapping[str, Section]
    make: Callable[..., Problem]
    example: Mapping[str, str]
    package: str = ""

    def __post_init__(self) -> None:
        """Refuse what no file could state."""
        sections: Any = self.sections  # of a package, that may bring anything
        if not isinstance(sections, Mapping) or not all(isinstance(found, Section) for found in sections.values()):
            raise PeriluneError(
                f"the sections of the kind {self.name} are not what a file has", got=repr(sections)[:80],
                expected="a dictionary of Section(record=...) by their names",
            )  # fmt: skip
        if "problem" not in sections or PROOF in sections:
            raise PeriluneError(
                f"the sections of the kind {self.name} are not what a file has", got=", ".join(map(str, sections)),
                expected=f"problem, which states the kind, among them, and {PROOF} not: every file may have that",
            )  # fmt: skip
        require_type(
            self.example, Mapping, f"what the example of the kind {self.name} can be", '{"section.key": "value"}'
        )
        known = [f"{name}.{key}" for name, section in self.in_file.items() for key in section.keys]
        for key in self.example:
            if key not in known:
                raise unknown_name(f"key, which the example of the kind {self.name} has,", key, known)

    @property
    def in_file(self) -> Mapping[str, Section]:
        """Return all sections of a file: those of the problem, and that of its proof."""
        return {**self.sections, PROOF: Section(record=Tolerance, required=False, otherwise=Tolerance())}
