"""Right-hand side of a system as machine code, which the stepping loop calls through a table of addresses.

The loop is the same for all systems whose events are located alike, and compiled once for them; here is what is a
system's own.
"""

from __future__ import annotations

from perilune.kernels.algebra.program import Program, hoist, trace_function
from perilune.kernels.algebra.system import ArcSystem
from perilune.kernels.code.emit import KernelSource, emit_kernels, library
from perilune.kernels.code.ir import INT, Int, Ptr, Writer
from perilune.kernels.flight.codegen_context import blend
from perilune.kernels.flight.records import EQUATIONS

_OFFSETS = "@offsets"


def equations_module(system: ArcSystem, width: int) -> str:
    """Return the IR of ``void equations(ptr table)``, which fills the table `records.EQUATIONS`, and of what it names.

    ``fill(p, constants)`` evaluates what depends on the parameters only; ``field(constants, mode, Y, spare, Y')``,
    ``crossings(constants, z, z', mode, (g, g'))`` and the transitions ``(constants, Y, Y after)`` take those constants.

    Parameters
    ----------
    system
        Equations and events of the arcs.
    width
        Number of lanes that step together.
    """
    return _EquationsWriter(system, width).text()


class _EquationsWriter:
    """The functions of a system in the writing: what depends only on the parameters, once, and the rest."""

    def __init__(self, system: ArcSystem, width: int) -> None:
        self.system, self.width = system, width
        self._once: list[tuple[str, int]] = []  # kernels of the parameters, and where their values go
        self._held: dict[str, int] = {}  # kernel: where the values it needs of them begin
        self._constants = 0  # how many values in all
        self._kernels: list[KernelSource] = []
        for mode in range(len(system.modes)):
            self._add(f"field{mode}", system.field_program(mode), (0,), 1)
        if system.events:
            self._add("at_crossings", trace_function(system.crossings()), (0, 1, 2), 3)
            for event, before in system.carried:
                self._add(_transition_symbol(event, before), trace_function(system.transition(event, before)), (0,), 1)

    def text(self) -> str:
        """Return the IR."""
        numbers = ", ".join(f"i64 {x}" for x in self.system.offsets)
        offsets = f"[{numbers}]" if numbers else "zeroinitializer"
        constant = f"{_OFFSETS} = internal constant [{len(self.system.offsets)} x i64] {offsets}\n"
        taking = [self._fill(), self._field()]
        if self.system.events:
            taking.append(self._taking("crossings", "at_crossings", "z", "rates", "mode"))
            taking += [
                self._taking(f"{_transition_symbol(*way)}.at", _transition_symbol(*way), "y")
                for way in self.system.carried
            ]
        operations = library([kernel.program for kernel in self._kernels], self.width)
        return "\n".join([constant, operations, emit_kernels(self._kernels, self.width), *taking, self._table()])

    def _add(self, name: str, program: Program, arguments: tuple[int, ...], parameters: int) -> None:
        before, during = hoist(program, parameters)
        self._kernels.append(KernelSource(name=f"{name}.once", program=before, arguments=(parameters,)))
        self._kernels.append(KernelSource(name=name, program=during, arguments=(*arguments, parameters)))
        self._once.append((f"{name}.once", self._constants))
        self._held[name] = self._constants
        self._constants += max(len(before.outputs), 1)

    def _call(self, w: Writer, name: str, *pointers: str) -> None:
        """Call a kernel: its buffers, the values it needs of the parameters, its result last."""
        *inputs, result = pointers
        held = w.at(Ptr("%constants", w.vector), self._held[name])
        w.run(f"call void @{name}({', '.join(f'ptr {x}' for x in (*inputs, held, result))})")

    def _taking(self, name: str, kernel: str, *inputs: str) -> str:
        """Write a function that takes all constants, of a kernel that takes its own."""
        w, taken = Writer(self.width), [f"%{x}" for x in inputs]
        self._call(w, kernel, *taken, "%result")
        return _define_function(name, ["%constants", *taken, "%result"], w)

    def _fill(self) -> str:
        w = Writer(self.width)
        for name, place in self._once:
            w.run(f"call void @{name}(ptr %p, ptr {w.at(Ptr('%constants', w.vector), place)})")
        return _define_function("fill", ["%p", "%constants"], w)

    def _field(self) -> str:
        """Write Y' of each lane in its mode. Where all lanes share a mode, as mostly they do, nothing is blended."""
        w, modes = Writer(self.width), len(self.system.modes)
        spare, result = Ptr("%spare", w.vector), Ptr("%result", w.vector)
        if modes == 1:
            self._call(w, "field0", "%y", result)
        else:
            here = w.load(Ptr("%mode", w.vector))
            for number in range(modes):
                mine = w.compare("oeq", here, w.const(float(number)))
                elsewhere = w.any(w.opposite(mine))
                with w.when(w.not_bit(elsewhere)):
                    self._call(w, f"field{number}", "%y", result)
                with w.when(w.and_bit(w.any(mine), elsewhere)):
                    self._call(w, f"field{number}", "%y", spare)
                    blend(w, mine, spare, result, self.system.size)
        return _define_function("field", ["%constants", "%mode", "%y", "%spare", "%result"], w)

    def _table(self) -> str:
        s, w = self.system, Writer(self.width)
        table = Ptr("%table", INT)
        sizes = {"nz": s.nz, "n": s.size, "np": s.np, "nc": s.nc, "constants": self._constants}
        for name, number in sizes.items():
            w.store(Int(str(number)), table, EQUATIONS.index(name))
        named = {"offsets": _OFFSETS, "fill": "@fill", "field": "@field"}
        if s.events:
            named["crossings"] = "@crossings"
        places = {EQUATIONS.index(name): symbol for name, symbol in named.items()}
        places |= {len(EQUATIONS) + k: f"@{_transition_symbol(*way)}.at" for k, way in enumerate(s.carried)}
        for place, symbol in places.items():
            w.store(w.let(INT, f"ptrtoint ptr {symbol} to i64"), table, place)
        return f"define void @equations(ptr %table) nounwind {{\n{w.body()}\n  ret void\n}}\n"


def _transition_symbol(event: int, before: int) -> str:
    return f"transition{event}_{before}"


def _define_function(name: str, arguments: list[str], w: Writer) -> str:
    taken = ", ".join(f"ptr {x}" for x in arguments)
    return f"define internal void @{name}({taken}) nounwind {{\n{w.body()}\n  ret void\n}}\n"
