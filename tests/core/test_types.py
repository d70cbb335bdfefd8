"""The types of the interface: what a type checker says of a user's script, and that the annotations are true."""

import inspect
import re
import subprocess
import sys
from pathlib import Path
from types import UnionType
from typing import Any, ClassVar, NamedTuple, Union, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from conftest import AXIS, ROOT
from tools import shipped

import mpt_helpers as mpt
import reproduction
from mpt_helpers import bands, metrics, riccati, tracks
from reproduction import plots

# What holds of the types of results; each line is one that a checker must accept.
RIGHT = """\
from dataclasses import replace
from typing import assert_type

import numpy as np
from numpy.typing import NDArray

import mpt_helpers as mpt
from mpt_helpers import metrics, riccati
from reproduction import plots
from reproduction.lasting import lasting_error

Array = NDArray[np.float64]
z = [[0.1], [float("nan")], [2.2]]
model = mpt.constant_velocity(dt=1, q=0.01, r=0.1, x0=[0, 1], P0=np.eye(2))
assert_type(model.F, Array)
assert_type(mpt.stack(model, model).n, int)
assert_type(mpt.LinearModel(F=[[1]], H=[[1]], Q=[[1]], R=[[1]]), mpt.LinearModel)
assert_type(replace(model, x0=np.ones(2)), mpt.LinearModel)
assert_type(mpt.simulate(model, N=5, rng=np.random.default_rng(1), tracks=3), tuple[Array, Array])
kf = mpt.KalmanFilter(model, t=[1, 2, 4.5], r=[[1.0], [2.0], [1.0]])
assert_type(kf.filter(z), Array)
assert_type(kf.covariances(10), Array)
assert_type(kf.estimates(z).P, Array)
x, P = kf.smooth(z)
assert_type(P, Array)
assert_type(kf.step(x[0], P[0], [1.0], dt=0.5, r=[0.1]), tuple[Array, Array])
steady = mpt.SteadyStateFilter.from_kalman(model)
assert_type(steady, mpt.SteadyStateFilter)
assert_type(steady.B, Array)
assert_type(mpt.SteadyStatePredictor(steady, steps=3).A, Array)
assert_type(mpt.FIRFilter.from_steady_state(steady).order, int)
assert_type(mpt.fir_order([[0.5]], 0.1, norm="fro"), int)
assert_type(mpt.Separate(kf, mpt.JoinFilter(kf, mpt.LainiotisFilter(model))).model, mpt.LinearModel)
assert_type(mpt.Predictor(kf, steps=3).filter(z), Array)
assert_type(mpt.six_filters(model)["KF"].filter(z), Array)
assert_type(metrics.innovations(kf, z).S, Array)
assert_type(metrics.chi_square_band(dof=2, runs=100), tuple[float, float])
assert_type(riccati.rekf(model), Array)
errors = metrics.ahead(mpt.KalmanFilter(model, t=[1, 2, 4.5]), z, seconds=1)
assert_type(metrics.following(errors), Array)
assert_type(lasting_error(model, sigma=1.0, tau=3600.0), mpt.LinearModel)
found = mpt.fit(lambda q, r: mpt.constant_velocity(1.0, q, r), z, q=1.0, r=1.0)
assert_type(found.values, dict[str, float])
assert_type(found.filter.filter(z), Array)
mpt.study(lambda rng, M: rng.standard_normal(M), runs=10, seed=1, workers=2)
fig, ax = plots.panels([["a"]])
plots.finish(ax["a"], "k", "A line")
names = {kf: "a filter", model: "a model"}
"""
# What a user may get wrong, and the code of the error on that line.
BEGIN = """\
import mpt_helpers as mpt
from mpt_helpers import metrics

model = mpt.gsm_axis(dt=1.0, q=0.01, r=0.1)
kf = mpt.KalmanFilter(model)
z = [[1.0], [2.0]]
"""
WRONG = {
    'mpt.gsm_axis(dt="1", q=0.01, r=0.1)': "arg-type",
    "mpt.gsm_axis(dt=1.0, q=0.01)": "call-arg",
    "mpt.KalmanFilter(F=[[1.0]])": "call-arg",
    "mpt.KalmanFilter(kf)": "arg-type",
    "mpt.LinearModel([[1.0]], [[1.0]], [[1.0]], [[1.0]])": "call-arg",
    "model.F = [[2.0]]": "misc",
    "kf.filtered(z)": "attr-defined",
    "kf.filter()": "call-arg",
    "kf.filter(None)": "arg-type",
    "kf.filter(model)": "arg-type",
    "kf.smooth(z).covariance": "attr-defined",
    "mpt.SteadyStateFilter.from_kalman(kf)": "arg-type",
    "mpt.SteadyStatePredictor(kf, steps=3)": "arg-type",
    "mpt.FIRFilter.from_steady_state(kf)": "arg-type",
    "mpt.Separate([kf, kf])": "arg-type",
    "mpt.stack([model, model])": "arg-type",
    "mpt.simulate(model, 10.0, 1234)": "arg-type",
    "mpt.study(1.0, runs=10, seed=1)": "arg-type",
    "metrics.nees(kf)": "call-arg",
    "metrics.innovations(z, kf)": "arg-type",
    "mpt.fit(lambda q: q, z, q='1')": "arg-type",
}


def errors_of(scripts, folder, cache):
    """The codes of the errors that mypy finds in each line of each script, {(name of the script, line): codes}."""
    for name, text in scripts.items():
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", "--no-color-output", "--no-error-summary"]
    # As of an installed package, no error within it is shown.
    command += ["--follow-imports=silent", "--config-file=", "--cache-dir", str(cache)]
    run = subprocess.run(
        [*command, *(f"{name}.py" for name in scripts)],
        cwd=folder,
        env={"MYPYPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 1, run.stdout + run.stderr  # 1: errors, those of "wrong"; 2: mypy fails
    found = {}
    for name, line, code in re.findall(r"(?m)^(\w+)\.py:(\d+): error: .*\[([\w-]+)\]$", run.stdout):
        found.setdefault((name, int(line)), set()).add(code)
    assert len(re.findall(": error: ", run.stdout)) >= len(WRONG)
    return found


@pytest.mark.slow  # `make types` runs it
def test_a_type_checker_finds_what_is_wrong_and_nothing_in_what_is_right(tmp_path, pytestconfig):
    """One test, since mypy takes seconds to begin; what it has found of numpy and the package it keeps for the next."""
    scripts = {"readme": shipped.README_CODE, "right": RIGHT, "wrong": BEGIN + "\n".join(WRONG) + "\n"}
    errors = errors_of(scripts, tmp_path, pytestconfig.cache.mkdir("mypy"))
    assert {key: codes for key, codes in errors.items() if key[0] != "wrong"} == {}
    for line, wrong in enumerate(WRONG, start=len(BEGIN.splitlines()) + 1):
        assert WRONG[wrong] in errors.get(("wrong", line), set()), wrong


def test_the_package_says_that_it_has_types():
    assert (Path(mpt.__file__).parent / "py.typed").is_file()


def public_functions():
    """Every function and method of the interface, by its name; a property is the function that it calls."""
    spaces = {"mpt": {name: getattr(mpt, name) for name in mpt.__all__}}
    spaces |= {module.__name__: vars(module) for module in (metrics, bands, riccati, tracks, plots)}
    found = {}
    for space, names in spaces.items():
        for name, value in names.items():
            own = getattr(value, "__module__", "").startswith("mpt_helpers")
            if name.startswith("_") or not own or (space != "mpt" and value.__module__ != space):
                continue
            if inspect.isfunction(value):
                found[f"{space}.{name}"] = value
            elif inspect.isclass(value) and not issubclass(value, tuple):
                for method, each in vars(value).items():
                    each = getattr(each, "fget", None) or getattr(each, "func", None) or getattr(each, "__func__", each)
                    if inspect.isfunction(each) and (not method.startswith("_") or method == "__init__"):
                        found[f"{space}.{name}.{method}"] = each
    return found


def test_every_public_function_says_its_types():
    functions = public_functions()
    assert len(functions) > 60
    for name, function in functions.items():
        signature = inspect.signature(function)
        told = [each.annotation for each in signature.parameters.values() if each.name not in ("self", "cls")]
        told += [] if name.endswith("__init__") else [signature.return_annotation]
        assert inspect.Parameter.empty not in told, name


def test_a_signature_can_be_read():
    """As help and editors show it: no object without a name, no type spelt out, no argument of inner use."""
    classes = [value for value in vars(mpt).values() if inspect.isclass(value) and issubclass(value, mpt._base.Filter)]
    modules = mpt._base, bands, metrics, mpt.fitting, mpt.tracks, mpt.tracks.fixes, mpt.tracks.noise_fit
    results = [value for module in modules for value in vars(module).values() if hasattr(value, "_fields")]
    assert len(results) >= 12
    for each in [*public_functions().values(), *classes, mpt.LinearModel, *results]:
        if getattr(each, "__name__", "") != "__init__":
            shown = str(inspect.signature(each))
            assert not re.search(r"<|ndarray\[tuple|ForwardRef|\b_\w+:", shown), shown


def fits(value, hint):
    """Tell whether a value is of an annotated type."""
    origin, parts = get_origin(hint), get_args(hint)
    if hasattr(origin, "__value__"):  # an alias, as numpy's NDArray is from 2.5 on
        return fits(value, origin.__value__[parts])
    if hint is Any:
        return True
    if origin is np.ndarray:
        return isinstance(value, np.ndarray) and value.dtype == get_args(parts[1])[0]
    if origin is ClassVar:
        return fits(value, *parts)
    if origin in (Union, UnionType):
        return any(fits(value, part) for part in parts)
    if origin is tuple:
        return isinstance(value, tuple) and len(value) == len(parts) and all(map(fits, value, parts))
    if origin is dict:
        return all(fits(key, parts[0]) and fits(each, parts[1]) for key, each in value.items())
    return isinstance(value, origin or hint)


class Call(NamedTuple):
    """A function of the interface, what it is called on (None for a function), and its arguments."""

    function: Any
    on: Any
    arguments: tuple


KF, STEADY = mpt.KalmanFilter(AXIS), mpt.SteadyStateFilter.from_kalman(AXIS)
Z = [[0.1], [np.nan], [2.2]]
CALLS = [
    Call(mpt.gsm_axis, None, (1, 1, 1)),
    Call(mpt.mean_track, None, (AXIS, 3)),
    Call(mpt.simulate, None, (AXIS, 3, np.random.default_rng(1))),
    Call(mpt.fir_order, None, ([[0.5]], 0.1)),
    Call(mpt.six_filters, None, (AXIS,)),
    Call(reproduction.gap_text, None, (1e-3,)),
    Call(metrics.relative_gap, None, ([1, 2], [1, 3])),
    Call(metrics.innovations, None, (KF, Z)),
    Call(metrics.nis, None, (KF, Z)),
    Call(metrics.nees, None, ([[1, 2]], np.eye(2))),
    Call(metrics.chi_square_band, None, (2, 10)),
    Call(metrics.error_moments, None, (STEADY, AXIS, 3)),
    Call(riccati.rekf, None, (AXIS,)),
    Call(riccati.relf, None, (AXIS,)),
    Call(mpt.LinearModel.over, mpt.constant_velocity(1, 1, 1), (2,)),
    *(Call(getattr(type(each), name), each, (Z,)) for each in (KF, STEADY) for name in ("filter", "estimates")),
    *(Call(type(each).step, each, ([0, 1], np.eye(2), [1])) for each in (KF, STEADY, mpt.LainiotisFilter(AXIS))),
    *(Call(type(each).covariances, each, (3,)) for each in (KF, STEADY, mpt.JoinFilter(KF, STEADY))),
    Call(mpt.LainiotisFilter.smooth, mpt.LainiotisFilter(AXIS), (Z,)),
    Call(mpt.SteadyStatePredictor.filter, mpt.SteadyStatePredictor(STEADY, 2), (Z,)),
]


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.function.__qualname__)
def test_a_result_is_what_the_annotation_says(call):
    result = call.function(*(() if call.on is None else (call.on,)), *call.arguments)
    hint = get_type_hints(call.function)["return"]
    assert fits(result, hint), (type(result), hint)


@pytest.mark.parametrize("each", [KF, STEADY, mpt.FIRFilter.from_steady_state(STEADY), AXIS, mpt.Predictor(KF, 2)])
def test_the_fields_and_properties_are_what_their_annotations_say(each):
    hints = get_type_hints(type(each))
    for name, value in inspect.getmembers_static(type(each), lambda value: isinstance(value, property)):
        if not name.startswith("_") and not (name == "P0" and isinstance(each, mpt.FIRFilter | mpt.Predictor)):
            hints[name] = get_type_hints(value.fget)["return"]
    assert len(hints) > 2
    for name, hint in hints.items():
        assert fits(getattr(each, name), hint), name
