"""Compilation of LLVM IR to machine code in this process, by llvmlite."""

from __future__ import annotations

import ctypes
import mmap
import platform
from collections.abc import Iterable
from functools import cache
from typing import Any

from numpy.typing import NDArray

from perilune.core import PeriluneError, sign_of_life

_PIECES = 1 << 23, 1 << 12, 1 << 14, 1 << 16, 1 << 20  # bytes: sections of all sizes
_TOGETHER = 2**31 - 2**27


def is_available() -> bool:
    """Return True if machine code can be made here."""
    try:
        import llvmlite.binding  # noqa: F401
    except ImportError:
        return False
    return True


def choose_native(backend: str | None) -> bool:
    """Return True if a backend means machine code: "native", "scipy", or None for native where it can be made.

    Raises
    ------
    PeriluneError
        On another choice.
    """
    if backend not in (None, "native", "scipy"):
        raise PeriluneError("no such backend", got=repr(backend), expected="native, scipy or None")
    return backend == "native" or (backend is None and is_available())


@cache
def host_processor() -> tuple[str, str, str]:
    """Return the processor that code is made for: its triple, its name and its features."""
    import llvmlite.binding as llvm

    features = llvm.get_host_cpu_features()
    return llvm.get_process_triple(), llvm.get_host_cpu_name(), features.flatten()


def code_versions() -> tuple[str, ...]:
    """Return what else the code depends on: the versions of CasADi, llvmlite and LLVM, and where it may be loaded."""
    return (*_library_versions(), *([] if _allocates_nearby() else ["anywhere"]))


@cache
def _library_versions() -> tuple[str, ...]:
    import casadi as ca
    import llvmlite
    import llvmlite.binding as llvm

    return ca.CasadiMeta.version(), llvmlite.__version__, ".".join(map(str, llvm.llvm_version_info))


def _allocates_nearby() -> bool:
    """Return True if memory that is asked for now lies together: LLVM aborts where code is 2 GB from its constants.

    In a process that holds more than that the system puts small pieces into gaps, far from larger ones. Code for
    anywhere is slower by a quarter, and made only then.
    """
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return True
    pieces = [mmap.mmap(-1, size) for size in _PIECES]
    places = [ctypes.addressof(ctypes.c_char.from_buffer(piece)) for piece in pieces]
    for piece in pieces:
        piece.close()
    return max(places) - min(places) < _TOGETHER


def _target_machine() -> Any:
    """Return a machine to generate code for; each module needs its own."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    triple, name, features = host_processor()
    target = llvm.Target.from_triple(triple)
    # Above level 1 comes what reorders the finished code: no quicker in flight, and a twentieth of the time here.
    return target.create_target_machine(
        cpu=name, features=features, opt=1, reloc="pic", codemodel="small" if _allocates_nearby() else "large", jit=True
    )


def compile_ir(text: str) -> bytes:
    """Compile a module to a relocatable object.

    Raises
    ------
    PeriluneError
        If LLVM refuses the module, with what it said.
    """
    import llvmlite.binding as llvm

    sign_of_life("compiling machine code")
    machine = _target_machine()
    try:
        module = llvm.parse_assembly(text)
        module.triple, module.data_layout = machine.triple, str(machine.target_data)
        module.verify()
    except RuntimeError as error:
        raise PeriluneError(
            "LLVM refuses the generated code",
            got=str(error)[:2000],
            advice="backend='scipy'; and report it",
        ) from error
    # Straight-line kernels leave the optimiser nothing to find: only the driver's variables become registers. The
    # least level of LLVM's own passes measures no quicker in flight, and took three fifths of the time here.
    passes = llvm.create_new_module_pass_manager()
    passes.add_sroa_pass()
    passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
    return machine.emit_object(module)


def array_address(array: NDArray[Any]) -> int:
    """Return where a contiguous array begins: ``array.ctypes.data``, in a sixth of its time where possible."""
    if array.size and array.flags.writeable:
        buffer: Any = array
        return ctypes.addressof(ctypes.c_char.from_buffer(buffer))
    return array.ctypes.data


def argument_table(entries: Iterable[int]) -> Any:
    """Return what machine code is handed: addresses and whole numbers, 64 bits each. It lives as long as it is held."""
    numbers = list(entries)
    return (ctypes.c_int64 * len(numbers))(*numbers)


class MachineCode:
    """An object file loaded into this process, for as long as it or one of its functions is held."""

    def __init__(self, content: bytes) -> None:
        import llvmlite.binding as llvm

        machine = _target_machine()
        self._engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(content))
        self._engine.finalize_object()

    def function(self, name: str, *arguments: Any) -> Any:
        """Return a function without result; calls of it release the interpreter's lock."""
        address = self._engine.get_function_address(name)
        if not address:
            raise KeyError(name)
        function: Any = ctypes.CFUNCTYPE(None, *arguments)(address)
        function.code = self  # lives as long as anything that can call it
        return function
