"""A problem, its solution and the record of its proof."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune.problem.casadi_trace import (
        SYMBOLIC,
        Kinked,
        Parameters,
        Unnumbered,
        canonical_free,
        canonical_given,
        column,
        elements,
        free_scales,
        state_scales,
        trace_at_end,
        trace_parameters,
        trace_rates,
        trace_sides,
    )
    from perilune.problem.checks import rows_out_of_range
    from perilune.problem.controls import (
        Control,
        Regime,
        ScalarControl,
        Settled,
        UnitVectorControl,
        admissible,
        admissible_rates,
        control_scales,
        control_slices,
        directions,
        limit_value,
        normalised,
        scalars,
        tangents,
    )
    from perilune.problem.display import views
    from perilune.problem.display.quantity_names import (
        end_text,
        free_name,
        kept_text,
        limit_name,
        objective_text,
        only_in_path,
        parameter_key,
        quantity_name,
        stating_keys,
    )
    from perilune.problem.initial_guess import fitting_guess, guess
    from perilune.problem.named_values import PAIRS, Conditions, Quantities, named_variables
    from perilune.problem.parameters import given_of
    from perilune.problem.perturbed import (
        fix_free_parameters,
        is_neighbour,
        move_start,
        narrow_free_parameters,
        offset_of,
        release_free_parameters,
        start_offsets,
        with_given_unchecked,
        with_start_offsets,
        without_start_offsets,
    )
    from perilune.problem.phase import Phase
    from perilune.problem.presolve import (
        Finding,
        at_start,
        between_bounds,
        is_possible,
        preflight,
        refuse_impossible,
        select_findings,
    )
    from perilune.problem.problem import Problem
    from perilune.problem.renamed_keys import with_new_keys
    from perilune.problem.results.arc_sequence import NamedArc
    from perilune.problem.results.extremal import Extremal, Nature
    from perilune.problem.results.hermite_nodes import hermite_nodes
    from perilune.problem.results.magnitudes import (
        BEYOND,
        ROUNDS,
        STILL,
        reached_sizes,
        supported_scale,
        supported_unit,
    )
    from perilune.problem.results.solution import Result, Solution, Statistics, full, results_between
    from perilune.problem.results.trajectory import Curve, Trajectory
    from perilune.problem.results.warnings import KNOWN_BETTER
    from perilune.problem.tolerance import LARGEST, SIZED, Tolerance, format_tolerance, quantity_in, unit_of
    from perilune.problem.tracing.costate_signs import cost_states, priced_rates, unpriced_states
    from perilune.problem.tracing.lie_derivatives import (
        MOST_ORDER,
        component,
        depends_linearly_on_control,
        depends_on_control,
        derivatives_to_control,
        gather_expressions,
        run_expression,
        total_derivative,
    )
    from perilune.problem.tracing.tape import ARITY, ROLES, Expression, NotAFormula, Recorder, Tape
    from perilune.problem.tracing.traced_problem import OWN_TEXT, PHASE_FUNCTIONS, TracedProblem, roles_of
    from perilune.problem.variables import FreeParameter, Parameter, Variable
    from perilune.problem.verification import LEVEL_NAMES, LEVELS, THEOREM, Check, Verification, format_failed_checks

else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)
