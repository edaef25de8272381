"""Foundation of all rooms: outcomes, units, maths, declarations, array types."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune.core.arrays import Matrix, Physics, Stack, Vector
    from perilune.core.callbacks import (
        Iteration,
        Progress,
        TimeLimitReached,
        Watch,
        enter_computation,
        ignore_events,
        remember_best,
        sign_of_life,
    )
    from perilune.core.column_headings import TableHeading, table_heading, unit_as_written
    from perilune.core.complex_step import COMPLEX, STEP, complex_step_jacobian, stack_broadcast
    from perilune.core.datetimes import END, EXAMPLE, instant
    from perilune.core.deprecation import (
        Asked,
        RenamedAttribute,
        moved_module,
        renamed_keywords,
        renamed_names,
        rewritten_keywords,
    )
    from perilune.core.errors import (
        BEST_MISSES,
        CANNOT_BE_FLOWN,
        InfeasibleError,
        Named,
        NotConvergedError,
        Outcome,
        PeriluneError,
        UnknownKindError,
        unknown_name,
    )
    from perilune.core.facade import lazy_face, method_function, public_names
    from perilune.core.fields import (
        LONGEST_VALUE,
        Key,
        Quantity,
        TextField,
        check_values,
        declared_parameters,
        parameter_name,
        quantity,
        record,
        record_keys,
        record_of_values,
        record_values,
        section_of,
        span,
        text_field,
        with_key_named,
    )
    from perilune.core.lazy import Deferred
    from perilune.core.maths import MOST_KNOTS, NUMERIC, NUMPY_NAMES, Table, comparison_fails
    from perilune.core.renaming import warn_renamed
    from perilune.core.stated_number import stated_text
    from perilune.core.units import (
        STANDARD_GRAVITY,
        Dimension,
        Scales,
        dimension_text,
        exact_quantity,
        format_bound,
        format_quantity,
        format_value_range,
        parse_quantity,
        parse_unit,
        quotient_unit,
        require_si_unit,
    )
    from perilune.core.untrusted_text import bounded_bytes, bounded_text, one_line, refuse_nested
    from perilune.core.validation import (
        check_call,
        check_operands,
        require_callable,
        require_distinct,
        require_identifier,
        require_index,
        require_integers,
        require_level,
        require_number,
        require_numbers,
        require_path,
        require_records,
        require_row,
        require_si_number,
        require_type,
        wrong_type_error,
    )

else:
    from perilune.core.facade import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)
