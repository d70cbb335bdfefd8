"""Monte Carlo studies: the same numbers whatever the number of workers."""

import os
import signal
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from itertools import count

import numpy as np
import pytest
from conftest import MODELS_2016, ROOT
from tqdm import tqdm

import mpt_helpers as mpt
from mpt_helpers.monte_carlo import BLOCK

STEADY = mpt.SteadyStateFilter.from_kalman(MODELS_2016["cv"])


def errors(rng, M):
    """The rms errors of a filter's states over 30 steps of tracks that it does not start on, (2, M)."""
    x, z = mpt.simulate(mpt.exact_motion(STEADY.model, [0, 20]), 30, rng, tracks=M)
    return mpt.metrics.rms(STEADY.filter(z) - x, axis=0)


def draws(rng, M):
    return rng.standard_normal((2, M))


@pytest.fixture(scope="module")
def expected():
    return mpt.study(errors, runs=1500, seed=4)


@pytest.mark.parametrize("workers", [2, 5])
def test_no_number_depends_on_the_workers(expected, workers):
    np.testing.assert_array_equal(mpt.study(errors, 1500, 4, workers=workers), expected)


def test_a_study_of_a_hundred_thousand_million_runs_begins_at_once():
    """The seeds of all its blocks were made first: it hung, without a bar that says how long it would take."""

    def interrupted(rng, M):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mpt.study(interrupted, 10**11, 1)


def test_workers_may_be_a_map(expected):
    with ThreadPoolExecutor(2) as pool:
        np.testing.assert_array_equal(mpt.study(errors, 1500, 4, workers=pool.map), expected)


def dies_at_the_third_call(folder, rng, M):
    """What errors gives; the process that makes the third call is killed there."""
    for call in count():
        with suppress(FileExistsError):
            folder.joinpath(str(call)).touch(exist_ok=False)
            break
    if call == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return errors(rng, M)


@contextmanager
def taken_port(port):
    """A port that is taken: by this test, if nobody has it."""
    with socket.socket() as own:
        with suppress(OSError):
            own.bind(("127.0.0.1", port))
            own.listen()
        yield


@pytest.mark.slow  # `make extras` runs a study on a cluster of dask, too
def test_workers_may_be_a_dask_cluster_and_a_killed_worker_loses_nothing(expected, tmp_path):
    from dask.distributed import Client, LocalCluster

    dying = partial(dies_at_the_third_call, tmp_path)
    two = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}  # a free port
    with taken_port(8787), LocalCluster(**two) as cluster, Client(cluster) as client:
        before = set(client.run(os.getpid).values())
        cluster_map = client.get_executor().map
        np.testing.assert_array_equal(mpt.study(errors, 1500, 4, workers=cluster_map), expected)
        np.testing.assert_array_equal(mpt.study(dying, 1500, 4, workers=cluster_map), expected)
        client.wait_for_workers(2)
        assert len(before) == 2
        assert len(before - set(client.run(os.getpid).values())) == 1  # one was killed indeed


def test_a_longer_study_begins_with_the_shorter_one(expected):
    for runs in (1, BLOCK - 1, BLOCK, 777):
        np.testing.assert_array_equal(mpt.study(errors, runs, 4), expected[:, :runs])


def test_runs_are_independent_and_seeds_matter():
    x = mpt.study(draws, 10 * BLOCK, seed=1)
    assert x.shape == (2, 10 * BLOCK)
    assert len(np.unique(x)) == x.size
    assert not np.intersect1d(x, mpt.study(draws, 10 * BLOCK, seed=2)).size
    # 4,000 standard normal numbers: the mean is known to 1/63, the variance to 1/45; five standard errors.
    assert abs(x.mean()) < 5 / 63
    assert abs(x.var() - 1) < 5 / 45


def test_the_study_is_silent_unless_on_a_terminal(capfd):
    mpt.study(draws, 1000, 1, workers=2)
    assert capfd.readouterr() == ("", "")


@pytest.mark.skipif(os.name == "nt", reason="a pseudo-terminal")
def test_a_terminal_shows_progress(monkeypatch):
    import pty
    import select
    import termios

    ours, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, (24, 80))
    with os.fdopen(theirs, "w") as terminal:
        monkeypatch.setattr("sys.stderr", terminal)
        mpt.study(lambda rng, M: rng.random(M), 100_000, 1)
        terminal.flush()
        assert select.select([ours], [], [], 0)[0], "nothing was written"
        assert b"/100000" in os.read(ours, 10_000)


@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
def test_an_interrupt_ends_the_study_with_the_blocks_at_work():
    code = (
        "import signal, time, mpt_helpers as mpt\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a job in the background ignores it
        "def slow(rng, M):\n    time.sleep(0.05)\n    return rng.random(M)\n"
        "print('ready', flush=True)\nmpt.study(slow, 1_000_000, 1, workers=2)"
    )
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "cwd": ROOT}
    run = subprocess.Popen([sys.executable, "-c", code], **pipes)
    assert run.stdout.readline() == b"ready\n"
    time.sleep(0.3)
    run.send_signal(signal.SIGINT)
    _, errors = run.communicate(timeout=20)  # a fraction of a second; the study takes four minutes
    assert run.returncode != 0
    assert b"KeyboardInterrupt" in errors


def test_an_interrupt_between_two_blocks_starts_no_further_block(monkeypatch):
    ran = []

    def slow(rng, M):
        ran.append(M)
        time.sleep(0.01)
        return rng.random(M)

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(tqdm, "update", interrupt)
    with pytest.raises(KeyboardInterrupt):
        mpt.study(slow, 100 * BLOCK, 1, workers=2)
    assert len(ran) < 50


def test_an_interrupt_while_blocks_are_handed_out_starts_no_further_block(monkeypatch):
    ran, handed_out, submit = [], count(1), ThreadPoolExecutor.submit

    def slow(rng, M):
        ran.append(M)
        time.sleep(0.01)
        return rng.random(M)

    def interrupted(*call):
        if next(handed_out) == 100:
            raise KeyboardInterrupt
        return submit(*call)

    monkeypatch.setattr(ThreadPoolExecutor, "submit", interrupted)
    with pytest.raises(KeyboardInterrupt):
        mpt.study(slow, 200 * BLOCK, 1, workers=2)
    assert len(ran) < 50


def test_an_error_in_an_experiment_is_passed_on():
    def broken(rng, M):
        raise RuntimeError("broken")

    for workers in (1, 2):
        with pytest.raises(RuntimeError, match="broken"):
            mpt.study(broken, 1000, 1, workers=workers)


@pytest.mark.parametrize("result", [1.0, np.zeros(3), np.zeros((BLOCK, 2))])
def test_a_result_without_a_column_for_each_run_is_refused(result):
    with pytest.raises(ValueError, match="experiment: needs a result of M = 200 columns"):
        mpt.study(lambda rng, M: result, 10, 1)


def test_an_experiment_may_return_the_same_buffer_again():
    buffer = np.empty(BLOCK)

    def drawn(rng, M):
        buffer[:] = rng.standard_normal(M)
        return buffer

    assert len(np.unique(mpt.study(drawn, 1000, 1))) == 1000


def test_more_runs_than_memory_are_refused_after_the_first_block():
    """Of 1e16 numbers no computer has the memory; a study that collected them would run until it was killed."""
    with pytest.raises(MemoryError, match="Unable to allocate"):
        mpt.study(lambda rng, M: rng.random(M), runs=10**16, seed=1)


def test_results_of_another_type_are_refused():
    def experiment(rng, M):
        values = rng.random(M)
        return values > 0 if values[0] < 0.5 else values

    with pytest.raises(ValueError, match="experiment: needs results of one shape and type"):
        mpt.study(experiment, runs=20_000, seed=1)
