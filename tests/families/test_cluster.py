"""Atlases in threads and on a Dask cluster: the same nodes to the last bit, whatever dies; what is refused."""

from __future__ import annotations

import os
import signal
import socket
import sys
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from pathlib import Path

import pytest

from cho import cho_landing
from command_line import HYBRID
from perilune.atlas.building.audit import sample_of
from perilune.atlas.building.build import build
from perilune.atlas.query.query import open_atlas
from perilune.cli import run_command_line
from perilune.core import PeriluneError
from perilune.families import dask_cluster as on_cluster
from perilune.families.dask_cluster import cluster
from perilune.families.executors import run_calls
from perilune.families.solve_many import solve_many
from perilune.solve import solve

AXES = {"vehicle.thrust": (430.0, 450.0), "retro.specific_impulse": (290.0, 310.0)}
VARY = ["--vary", "vehicle.thrust=430:450 N"]


def shards(place: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in place.glob("*.npy")}


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="a POSIX signal")
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")  # of Dask itself
def test_a_worker_that_is_killed_is_no_loss(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="needs the extra 'cluster'")
    build(cho_landing(), AXES, tmp_path / "here", sample=0)
    killed = list[int]()
    quiet = {"dashboard_address": ":0", "silence_logs": 50}
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, **quiet) as local:

        def watch(line: object) -> None:
            if str(line).startswith("3 of 16 bricks") and not killed:
                killed.append(next(iter(local.workers.values())).process.pid)
                os.kill(killed[0], signal.SIGKILL)

        with cluster(local.scheduler_address) as machines:
            build(cho_landing(), AXES, tmp_path / "there", machines, callback=watch, sample=1)
            with pytest.raises(PeriluneError, match="tolerance"):
                build(cho_landing(), AXES, tmp_path / "there", machines, tolerance=1.0)
            points, known = {"vehicle.thrust": [430.0, 445.0, -1.0]}, solve(cho_landing(), verify=0)
            batch = solve_many(cho_landing(), points, known, executor=machines)
            assert machines.submit(sorted, [2, 1]).result() == [1, 2]
            with pytest.raises(ZeroDivisionError):
                machines.submit(divmod, 1, 0).result()
            waiting = machines.submit(sorted, [3])
            waiting.cancel()
            with pytest.raises(BrokenExecutor):
                waiting.result()
    alone = solve_many(cho_landing(), points, known)
    assert batch.objective.tolist()[:2] == alone.objective.tolist()[:2] and batch.messages == alone.messages
    assert killed and shards(tmp_path / "here") == shards(tmp_path / "there")
    assert sample_of(open_atlas(tmp_path / "there")).proved == 1


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")  # of Dask itself
def test_where_nobody_computes_it_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed", reason="needs the extra 'cluster'")
    monkeypatch.setattr(on_cluster, "_LOOK", 0.1)

    def tell(line: str) -> None:
        raise KeyboardInterrupt(line)  # as a user who reads it may

    quiet = {"dashboard_address": ":0", "silence_logs": 50}
    with distributed.LocalCluster(n_workers=0, processes=False, protocol="tcp://", **quiet) as local:
        with cluster(local.scheduler_address, tell) as machines, pytest.raises(KeyboardInterrupt, match="no worker"):
            next(run_calls(machines, iter([("one", (sorted, [2, 1]))])))
        local.scale(1)
        with cluster(local.scheduler_address, tell) as machines:
            assert list(run_calls(machines, iter([("one", (sorted, [2, 1]))]))) == [("one", [1, 2])]


def test_threads_make_the_same_nodes(tmp_path: Path) -> None:
    build(cho_landing(), AXES, tmp_path / "here", sample=0)
    with ThreadPoolExecutor(3) as pool:
        build(cho_landing(), AXES, tmp_path / "there", pool, sample=1)
    assert shards(tmp_path / "here") == shards(tmp_path / "there")
    assert sample_of(open_atlas(tmp_path / "there")).proved == 1


def test_addresses_at_which_nobody_answers_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("distributed", reason="needs the extra 'cluster'")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    order = ["atlas", "build", HYBRID, *VARY, "--out", str(tmp_path / "a"), "--scheduler"]
    for address in (f"tcp://127.0.0.1:{port}", "nonsense", "tcp://host", "tcp://127.0.0.1:99999", "tcp://no such:1"):
        assert run_command_line([*order, address]) == 2
        assert "no scheduler answers" in capsys.readouterr().err
    assert run_command_line([*order, "tcp://127.0.0.1:1", "--workers", "2"]) == 2
    assert "exclude each other" in capsys.readouterr().err
    assert not (tmp_path / "a").exists()


def test_without_the_extra_it_is_said_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    order = ["atlas", "build", HYBRID, *VARY, "--out", str(tmp_path / "a"), "--scheduler", "tcp://127.0.0.1:1"]
    assert run_command_line(order) == 2
    assert "pip install 'perilune[cluster]'" in capsys.readouterr().err and not (tmp_path / "a").exists()
