"""The command line in a process of its own: the main job, Ctrl-C, start-up, and files that mean harm."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from threading import Event, Lock, Timer
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import perilune
from command_line import COMMAND, ENVIRONMENT, HYBRID, read_json, snapshot
from perilune.cli.interrupts import defer_interrupt
from perilune.cli.output import CommandAnswer, emit_answer
from perilune.cli.progress import progress
from perilune.core import NotConvergedError
from perilune.direct import nlp
from perilune.direct.ipopt_events import IterationCallback, rewrite_interrupt_messages


@pytest.fixture(autouse=True, scope="module")
def ctrl_c_is_heard() -> Iterator[None]:
    """A shell lets what it starts in the background ignore Ctrl-C, and whatever that starts: not so here."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_the_main_job_in_a_process_of_its_own() -> None:
    done = subprocess.run(
        [*COMMAND, "solve", HYBRID, "--json"], capture_output=True, text=True, env=ENVIRONMENT, timeout=120
    )
    assert done.returncode == 0, done.stderr
    document = read_json(done.stdout)
    assert document["outcome"] == "PROVED"
    assert document["verification"]["level"] == 3
    assert all(check["passed"] for check in document["verification"]["checks"])
    value = {name: entry["value"] for name, entry in document["results"].items()}
    # The table "truth to reach" of the project, computed independently; V0 also printed in Cho et al. 2015,
    # (25).
    assert value["landed_mass"] == pytest.approx(160.618584, abs=1e-6)
    assert value["delta_v"] == pytest.approx(1200.944, abs=1e-3)
    assert value["flight_time"] == pytest.approx(286.864, abs=1e-3)
    assert value["perilune_speed"] == pytest.approx(1691.96926, abs=1e-5)
    assert value["propellant"] == pytest.approx(300.0 - value["landed_mass"], abs=1e-9)
    natures = [(round(e["delta_v"]), e["nature"]) for e in document["extremals"]]
    assert natures[0] == (1201, "best of the extremals found")
    assert {delta_v for delta_v, _ in natures} == {1201, 0, 129}


def test_ctrl_c_leaves_what_was_computed_and_nothing_half_done(
    tmp_path: Path,
) -> None:
    out = tmp_path / "out"
    process = subprocess.Popen(
        [*COMMAND, "solve", HYBRID, "--starts", "200000", "--out", str(out), "--verbose", "--json"],  # a minute's work
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=ENVIRONMENT,
    )
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("start"):
            break
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in stderr
    assert read_json(stdout)["outcome"] == "INTERRUPTED"
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    assert set(snapshot(out)) == {"failure.json"}
    kept = read_json((out / "failure.json").read_text(encoding="utf-8"))
    assert any(line.startswith("start") for line in kept["log"])


def test_ctrl_c_in_the_direct_method_is_told_in_our_words_only(capsys: pytest.CaptureFixture[str]) -> None:
    """CasADi prints a warning of its own where IPOPT is stopped; what else goes to standard error is kept."""
    x, many = ca.MX.sym("x"), ca.MX(ca.linspace(0, 1, 1_000_000))
    program = {"x": x, "f": ca.sumsqr(ca.sin(many * x) - 0.3 + 1e-3 * x * many), "p": ca.MX.sym("p", 0)}
    options = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-300}
    solver = nlp._Solver(ca.nlpsol("slow", "ipopt", program, options), IterationCallback(1, 0, 0), Lock())
    none = np.empty(0)
    posed: Any = SimpleNamespace(given=none, lower=np.array([-9.0]), upper=np.array([9.0]), low=none, high=none)
    stop = Timer(0.2, lambda: os.kill(os.getpid(), signal.SIGINT))
    stop.start()
    with pytest.raises(KeyboardInterrupt):
        solver(posed, np.array([5.0]))
        time.sleep(1.0)
        pytest.fail("it was over before it was stopped")
    with rewrite_interrupt_messages():
        print("something else\nand a piece", end="", file=sys.stderr)
    assert capsys.readouterr().err == "something else\nand a piece"


def test_ctrl_c_in_a_destructor_is_not_lost() -> None:
    """What a destructor raises is ignored: the signal comes again, and the work ends."""
    program = (
        "import os, signal, sys, time, perilune.cli as cli\n"
        "class Closing:\n"
        "    def __del__(self):\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "        time.sleep(0.05)\n"
        "def work(arguments):\n"
        "    Closing()\n"
        "    try:\n"
        "        for _ in range(2000):\n"
        "            time.sleep(0.01)\n"
        "    except KeyboardInterrupt:\n"
        "        return 130\n"
        "    return 0\n"
        "cli.run_command_line = work\n"
        "cli.main()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=ENVIRONMENT, timeout=60)
    assert (done.returncode, done.stderr) == (130, "")


def test_ctrl_c_before_there_is_anybody_to_answer_ends_it_without_a_word() -> None:
    """Not a traceback: the shell sees 130. Before that little is loaded, where nothing can be said."""
    program = (
        f"import sys; sys.path.insert(0, {str(Path(perilune.__file__).parents[1])!r})\n"
        "import perilune.cli as cli\n"
        "slow = [name for name in ('enum', 'typing', 're', 'threading') if name in sys.modules]\n"
        "class Stopped:\n"
        "    def find_spec(self, name, *_):\n"
        "        name == 'perilune.cli.interrupts' and cli.os.kill(cli.os.getpid(), 2)\n"
        "sys.meta_path.insert(0, Stopped())\n"
        "print(slow, flush=True)\n"
        "cli.main()\n"
    )
    done = subprocess.run([sys.executable, "-S", "-c", program], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "[]\n", "")


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="a POSIX signal")
def test_workers_of_a_killed_program_end() -> None:
    """They hold both ends of the queue from which they are told what to do, and would wait for ever."""
    killed = "import os; from perilune.cli.sweep import worker_pool as workers\n"
    killed += "with workers(2) as pool: pool.submit(abs, -1).result(); os.kill(os.getpid(), 9)"
    one = subprocess.Popen([sys.executable, "-c", killed], env=ENVIRONMENT, stdout=subprocess.PIPE)
    assert one.communicate(timeout=30) == (b"", None)  # whoever lives holds the other end of this
    assert one.returncode == -signal.SIGKILL


def test_a_program_ends_in_order_while_a_thread_still_makes_machine_code() -> None:
    """As the explorer does at Ctrl-C: at exit the compiler's globals go away below the thread, which crashes."""
    busy = """
import threading, time
from llvmlite import binding
import perilune.cli as cli
binding.initialize_native_target()
binding.initialize_native_asmprinter()
begun = threading.Event()
lines = "".join(f"  %x{k + 1} = fmul double %x{k}, {1.5 + k:.17e}\\n" for k in range(20_000))
text = f"define double @f(double %x0) {{{lines}  ret double %x20000}}"
def compile_on():
    while True:
        target = binding.Target.from_default_triple().create_target_machine()
        module = binding.parse_assembly(text)
        begun.set()
        binding.create_mcjit_compiler(module, target).finalize_object()
def run(_):
    threading.Thread(target=compile_on, daemon=True).start()
    begun.wait(20)
    time.sleep(0.2)
    return 0
cli.run_command_line = run
cli.main()
"""
    done = subprocess.run([sys.executable, "-c", busy], capture_output=True, text=True, env=ENVIRONMENT, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")


def test_help_loads_nothing_heavy() -> None:
    heavy = "numpy scipy casadi matplotlib pydantic llvmlite rich"
    program = (
        "import sys, perilune.cli\n"
        "code = perilune.cli.run_command_line(['--help'])\n"
        f"print(code, [m for m in {heavy.split()} if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=ENVIRONMENT)
    assert done.stderr.strip() == "0 []"
    assert "solve" in done.stdout


def test_a_landing_is_solved_and_proved_without_scipy() -> None:
    """Nor anything else that only other problems, or refusals, need: it would be half of what the program takes."""
    spared = "scipy matplotlib pandas pyarrow xarray importlib.metadata perilune.direct"
    spared += " perilune.models.deorbit.records perilune.models.descent.problem perilune.models.precision.problem"
    program = (
        "import sys, perilune.cli\n"
        f"code = perilune.cli.run_command_line(['solve', {str(HYBRID)!r}])\n"
        f"print(code, [m for m in {spared.split()} if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=ENVIRONMENT)
    assert done.stderr.splitlines()[-1] == "0 []"
    assert "level 3 (locally optimal)" in done.stdout


BAD_FILES: dict[str, bytes] = {
    "empty": b"",
    "nested": b"x = " + b"[\n" * 30_000,
    "tables": b"[" + b"a." * 450 + b"a]\n" + b"b=1\n",
    "many tables": b"".join(b"[a%d]\n" % k for k in range(8000)),
    "dotted": b"\n".join(b".".join([b"a"] * 400) + b".b%d = 1" % k for k in range(75)),
    "huge": b"#" * 50_000_000,
    "binary": bytes(range(256)) * 100,
    "long number": b"x = " + b"9" * 60_000,
    "quotes": b'x = """' + b'"\\' * 30_000,
    "power": b'[vehicle]\nmass = "9**9**9 kg"\n',
}


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="peak memory is read from /proc")
@pytest.mark.parametrize("name", BAD_FILES)
def test_a_bad_file_answers_quickly_and_small(tmp_path: Path, name: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_bytes(BAD_FILES[name])
    # Not getrusage: its peak survives exec, so it would be that of this test process.
    program = (
        "import sys, time; from perilune.cli import run_command_line as run\n"
        "code = run(sys.argv[1:])\n"
        "peak = next(line for line in open('/proc/self/status') if line.startswith('VmHWM'))\n"
        "print(time.process_time(), peak.split()[1], file=sys.stderr)\n"
        "sys.exit(code)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, "solve", str(path), "--json"],
        capture_output=True,
        text=True,
        env=ENVIRONMENT,
    )
    took, peak = done.stderr.split()[-2:]
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert read_json(done.stdout)["error"]["what"]
    assert int(peak) * 1024 < 200e6
    assert float(took) < 2.0  # s of the processor; 0.3 s measured


@pytest.mark.parametrize("arguments", [["new"], ["--help"], ["new", "--help"], ["--version"]])
def test_a_reader_that_leaves_early_is_no_fault(arguments: list[str]) -> None:
    process = subprocess.Popen([*COMMAND, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=ENVIRONMENT)
    assert process.stdout is not None and process.stderr is not None
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait(timeout=30) == 0


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/dev/full is needed")
def test_an_answer_that_cannot_be_written_is_told() -> None:
    with open("/dev/full", "w", encoding="utf-8") as full:
        done = subprocess.run(
            [*COMMAND, "new"], stdout=full, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT, timeout=30, check=False
        )
    assert done.returncode == 2
    assert "the answer cannot be written" in done.stderr
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


def test_a_stop_that_foreign_code_has_swallowed_is_met_at_the_next_line(monkeypatch: pytest.MonkeyPatch) -> None:
    stopped, log = Event(), deque[str]()
    monkeypatch.setattr("perilune.cli.interrupts.STOPPED", stopped)
    with progress(False, log) as watch:
        watch("one")
        stopped.set()
        with pytest.raises(KeyboardInterrupt):
            watch("two")
    assert list(log) == ["one", "two"]


def test_a_stop_waits_until_what_was_computed_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("perilune.cli.interrupts.STOPPED", Event())
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    done = list[str]()
    with pytest.raises(KeyboardInterrupt), defer_interrupt():
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)
        done.append("kept")
    assert done == ["kept"]


@pytest.mark.parametrize("error", [NotImplementedError("Wrong number or type of arguments"), NotConvergedError("lost")])
def test_what_foreign_code_makes_of_a_stop_is_a_stop(
    error: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """CasADi takes the exception for one of its own, and the file would be told that there is no flight."""
    stopped = Event()
    monkeypatch.setattr("perilune.cli.output.STOPPED", stopped)

    def work() -> CommandAnswer:
        stopped.set()
        raise error

    assert emit_answer(False, work) == 130
    assert capsys.readouterr().err == "perilune: stopped by the user\n"


def test_a_package_that_was_taken_away_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> CommandAnswer:
        raise ModuleNotFoundError("No module named 'scipy'", name="scipy")

    assert emit_answer(False, work) == 2
    assert capsys.readouterr().err == (
        "perilune: perilune needs scipy, which is not installed\n  try: pip install perilune\n"
    )


def test_a_second_stop_changes_nothing_of_what_was_said() -> None:
    """As what a destructor swallowed comes again, it may come when the program is about to leave."""
    code = (
        "import os, perilune.cli as c; c.run_command_line = lambda _: 130; "
        "c.gc.freeze = lambda: os.kill(os.getpid(), 2); c.main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=ENVIRONMENT, timeout=30, check=False
    )
    assert (done.returncode, done.stderr) == (130, "")
