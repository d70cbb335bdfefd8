"""The house: which room may use which, what entering it costs, and what it keeps."""

import ast
import copy
import gc
import pickle
import subprocess
import sys
import tracemalloc
import weakref
from dataclasses import replace
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from conftest import AXIS

import mpt_helpers as mpt
import reproduction

PACKAGE = Path(mpt.__file__).parent
# Each module of the core may import those that stand before it, and of the package nothing else.
CORE = ["_checks", "_immutable", "equations", "_engine.shared"]
CORE += ["_engine.columns", "_engine.pieces", "_engine.diffuse", "_engine.run", "_engine.smoother"]
CORE += ["model", "riccati", "_base", "kalman"]
CORE += ["lainiotis", "steady", "predictor", "combined", "bands", "metrics", "search", "fitting", "monte_carlo"]
# The engine knows arrays and equations only.
OF_THE_ENGINE = {"_checks", "equations"}
REPRODUCTION = Path(reproduction.__file__).parent
STEADY = mpt.SteadyStateFilter.from_kalman(AXIS)
EVERY_FILTER = {
    **mpt.six_filters(AXIS),
    "FIR": mpt.FIRFilter.from_steady_state(STEADY),
    "ahead": mpt.SteadyStatePredictor(STEADY, 2),
    "separate": mpt.Separate(mpt.KalmanFilter(AXIS), mpt.LainiotisFilter(AXIS)),
}


def imports(path):
    """Return what a file imports, wherever in it: {package: modules in it} for both halves, and all other packages."""
    top = path.parent
    while (top.parent / "__init__.py").exists():
        top = top.parent
    module = path.relative_to(top.parent).with_suffix("").parts
    inside = {"mpt_helpers": set(), "reproduction": set()}
    outside = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [tuple(each.name.split(".")) for each in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = module[: len(module) - node.level] if node.level else ()
            base += tuple(filter(None, (node.module or "").split(".")))
            names = [(*base, each.name) for each in node.names]
        else:
            continue
        for first, *rest in names:
            if first not in inside:
                outside.add(first)
            elif rest:
                inside[first].add(module_of(top.parent / first, rest))
    return inside, outside


def module_of(package, names):
    """Return the module of a package that (module, ..., name) leads to, with dots between its folders."""
    for n in range(len(names), 0, -1):
        place = package.joinpath(*names[:n])
        if place.with_suffix(".py").exists():
            return ".".join(names[:n])
    return names[0]


def name_of(path):
    """Return the name of a module of the package, with dots between its folders."""
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts)


MODULES = {name_of(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def test_imports_point_one_way():
    """Tracks over the core, the core over the engine, the engine over arrays and equations; none over the papers."""
    for name, path in MODULES.items():
        inside, outside = imports(path)
        assert inside["reproduction"] == set(), name
        used = inside["mpt_helpers"]
        if name.endswith("__init__") or name == "__main__":
            continue
        if name.startswith("tracks."):
            assert not {each for each in used if each.startswith("_engine.")}, name
            continue
        before = CORE[: CORE.index(name)] if name in CORE else CORE  # a module that is added may use all of the core
        assert used <= set(before), name
        if name.startswith("_engine."):
            assert {each for each in used if not each.startswith("_engine.")} <= OF_THE_ENGINE, name
        assert outside - set(sys.stdlib_module_names) <= {"numpy", "scipy", "filterpy", "tqdm"}, name


def test_an_added_module_is_used_by_no_other():
    """So that a motion, a filter or a gate of one's own is one file. Whatever the package uses stands in the list."""
    assert set(CORE) <= set(MODULES)
    added = {name for name in MODULES if name not in CORE and not name.startswith(("tracks.", "__", "_engine.__"))}
    for path in MODULES.values():
        assert not imports(path)[0]["mpt_helpers"] & added, path


def test_the_upper_half_keeps_to_its_rooms():
    """The ledger knows no filter, and nothing but a notebook a paper."""
    for path in sorted(REPRODUCTION.rglob("*.py")):
        room = path.relative_to(REPRODUCTION).parts[0].removesuffix(".py")
        inside, _ = imports(path)
        used = {each.partition(".")[0] for each in inside["reproduction"]} - {room}
        assert not {each for each in used if each.startswith("paper")}, path
        if room == "ledger":
            assert not used | inside["mpt_helpers"], path


IMPORT = """\
import sys
from time import process_time as now
start = now()
import numpy, scipy.linalg, filterpy.kalman
libraries = now() - start
import mpt_helpers
print((now() - start) / libraries, *sys.modules)"""


def imported():
    """Return the processor time of an import of the package over that of its libraries, and all that is loaded."""
    run = subprocess.run([sys.executable, "-c", IMPORT], capture_output=True, text=True, check=True)
    cost, *loaded = run.stdout.split()
    return float(cost), set(loaded)


def test_importing_costs_what_the_libraries_cost_and_no_matplotlib():
    """By 15 % more at most: 8 % here, 12 % with the oldest libraries on a busy machine.

    It is processor time, and one of three tries is enough.
    """
    cost, loaded = imported()
    assert "mpt_helpers.metrics" in loaded
    assert not {"matplotlib", "mpt_helpers.plots", "reproduction"} & loaded
    assert cost <= 1.15 or any(imported()[0] <= 1.15 for _ in range(2))


def test_a_module_is_a_module():
    """And not the function of the same name."""
    for name in MODULES:
        if not name.endswith("__"):
            import_module(f"mpt_helpers.{name}")
            assert isinstance(attrgetter(name)(mpt), ModuleType)


@pytest.fixture(scope="module")
def frozen():
    """No collection looks at what was there before: pytest holds a million objects."""
    gc.collect()
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.mark.usefixtures("frozen")
@pytest.mark.parametrize("name", EVERY_FILTER)
def test_a_filter_that_is_dropped_is_freed(name):
    each = copy.copy(EVERY_FILTER[name])
    z = np.zeros((30, each.model.m, 3))
    z[4:6, :, 1] = np.nan
    each.filter(z)
    if name != "FIR":
        each.covariances(z)
    reference = weakref.ref(each)
    del each
    gc.collect()
    assert reference() is None


@pytest.mark.usefixtures("frozen")
@pytest.mark.parametrize("name", ["KF", "LF", "SSKF", "FIR"])
def test_a_filter_keeps_no_memory_of_what_it_has_seen(name):
    """Of several long tracks with gaps of their own, one leaves nothing: other threads may allocate beside another."""
    each = copy.copy(EVERY_FILTER[name])
    rng = np.random.default_rng(0)
    held = []
    tracemalloc.start()
    for _ in range(4):
        z = np.zeros((200, each.model.m))
        z[rng.random(200) < 0.1] = np.nan
        each.filter(z)
        if name != "FIR":
            each.covariances(z)
        del z
        gc.collect()
        held.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert np.diff(held).min() < 10_000  # the steps of one track hold some 20,000 at least


COPIES = {"copy": copy.copy, "deepcopy": copy.deepcopy, "pickle": lambda each: pickle.loads(pickle.dumps(each))}


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
def test_models_and_filters_stay_immutable_when_they_are_copied(copied):
    model = copied(mpt.stack(AXIS, AXIS))
    assert model == mpt.stack(AXIS, AXIS)
    arrays = [getattr(model, name) for name in ("F", "H", "Q", "R", "x0", "P0")]
    for each in map(copied, EVERY_FILTER.values()):
        arrays += [each.model.F, *(getattr(each, name) for name in ("A", "B", "P", "taps") if name in vars(each))]
    assert len(arrays) > 20
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array.flat[0] = 1
    with pytest.raises(AttributeError):
        model.F = np.eye(4)


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
def test_a_copy_of_a_filter_that_ran_is_the_filter(copied):
    for name, each in EVERY_FILTER.items():
        z = np.arange(20.0 * each.model.m).reshape(20, each.model.m)
        x = each.filter(z)
        np.testing.assert_array_equal(copied(each).filter(z), x, err_msg=name)


def test_a_field_can_be_replaced():
    predictor = replace(mpt.SteadyStatePredictor(STEADY, 2), steps=5)
    np.testing.assert_array_equal(predictor.P, mpt.SteadyStatePredictor(STEADY, 5).P)
    other = mpt.gsm_axis(1.0, 0.02, 0.1)
    assert replace(mpt.KalmanFilter(AXIS), model=other).model == other
    assert replace(AXIS, x0=[1.0, 2.0]).P0.shape == (2, 2)


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
def test_models_and_filters_are_compared_by_value(copied):
    for name, each in EVERY_FILTER.items():
        other = copied(each)
        each.filter(np.ones((5, each.model.m)))  # what a filter keeps for its next run is no part of its value
        assert other is not each, name
        assert other == each, name
        assert {each: name}[other] == name
        assert {each.model: name}[other.model] == name
        assert [key for key in EVERY_FILTER if EVERY_FILTER[key] == each] == [name]


def test_another_number_anywhere_makes_another_model_or_filter():
    model = mpt.constant_velocity(1.0, 0.01, 0.1, P0=np.eye(2))
    t, r = [1.0, 2.0], [[0.1], [np.nan]]
    each = mpt.KalmanFilter(model, t=t, r=r)
    assert each == mpt.KalmanFilter(model, t=t, r=r)  # NaN stands for the variance of no measurement
    assert hash(each) == hash(mpt.KalmanFilter(model, t=t, r=r))
    others = [
        *(replace(each, model=replace(model, **{name: 2 * getattr(model, name)})) for name in ("H", "R", "P0")),
        replace(each, model=model.with_noise_times(2.0)),
        replace(each, model=replace(model, x0=np.ones(2))),
        replace(each, model=replace(model, dt=None, transition=None), t=None),
        replace(each, t=[1.0, 3.0]),
        replace(each, t=None),
        replace(each, r=[[0.2], [np.nan]]),
        replace(each, r=None),
        mpt.LainiotisFilter(model),
        model,
        "another",
    ]
    for other in others:
        assert other != each
    assert len({each, *others}) == 1 + len(others)
    predictor = mpt.Predictor(each, 2)
    assert predictor != replace(predictor, steps=3)


def test_minus_zero_is_zero():
    model = mpt.LinearModel(F=[[0.0]], H=[[1.0]], Q=[[1.0]], R=[[1.0]])
    assert replace(model, F=np.array([[-0.0]])) == model
    assert hash(replace(model, F=np.array([[-0.0]]))) == hash(model)
