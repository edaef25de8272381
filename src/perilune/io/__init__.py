"""Files of solutions: written and read back."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune.io.atomic_files import (
        DRAWN_BY,
        FAILURE_FILE,
        FIGURES,
        NotWrittenError,
        finite,
        fresh_directory,
        fresh_file,
        in_use,
        json_text,
        new_file,
        refuse_name_of_file,
        refuse_unwritten,
        unwritten,
        write_each,
    )
    from perilune.io.columns import (
        Column,
        display_times,
        display_unit,
        flight_columns,
        hamiltonian,
        hamiltonian_terms,
        per_unit,
        phase_columns,
        required_hamiltonian,
        round_degrees,
    )
    from perilune.io.exports.epochs import flight_epoch
    from perilune.io.exports.formats import format_of
    from perilune.io.exports.provenance import provenance
    from perilune.io.exports.table import FlightColumn
    from perilune.io.exports.tabular import cf_unit, package_of_extra
    from perilune.io.exports.writing import export_target, require_object, write_export
    from perilune.io.format import LARGEST_FILE, SOLUTION_FILE, hash_of
    from perilune.io.json_checks import array, enumeration_member, part, refuse_entry, short_text, tree
    from perilune.io.load import claims_of, load_with_tree, read_answer, read_trajectories
    from perilune.io.problem_document import read_problem, reread_problem
    from perilune.io.save import (
        answer_document,
        extremals_document,
        program_versions,
        results_document,
        solution_document,
        solution_files,
        whole_document,
        write_solution_files,
    )
else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)
