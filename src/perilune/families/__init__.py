"""Families of solutions along parameters."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune.families.batch import Batch
    from perilune.families.dask_cluster import cluster
    from perilune.families.executors import (
        Call,
        Submits,
        begin_processes,
        end_with_parent,
        ignore_interrupt_in_children,
        run_calls,
    )
    from perilune.families.family import Family
    from perilune.families.family_table import MemberTable, member_table, shown_column
    from perilune.families.points import grid_points
    from perilune.families.store_directory import MANIFEST, clear_family
else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)
