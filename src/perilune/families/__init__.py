"""Families of solutions along parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

from perilune.core.facade import deferred

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from perilune.families.dask_cluster import cluster
    from perilune.families.executors import (
        Call,
        Submits,
        begin_processes,
        end_with_parent,
        ignore_interrupt_in_children,
        run_calls,
    )
    from perilune.families.export_frames import grid_of, member_quantities, result_fields
    from perilune.families.family import Family, FamilyPoint
    from perilune.families.store import MANIFEST, clear_family


__all__ = [
    "MANIFEST",
    "Call",
    "Family",
    "FamilyPoint",
    "Submits",
    "begin_processes",
    "clear_family",
    "cluster",
    "end_with_parent",
    "grid_of",
    "ignore_interrupt_in_children",
    "member_quantities",
    "result_fields",
    "run_calls",
]

__getattr__: Callable[[str], Any] = deferred(
    __name__,
    {
        "dask_cluster": "cluster",
        "executors": "Call Submits begin_processes end_with_parent ignore_interrupt_in_children run_calls",
        "export_frames": "grid_of member_quantities result_fields",
        "family": "Family FamilyPoint",
        "store": "MANIFEST clear_family",
    },
)
