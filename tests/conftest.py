import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mpt_helpers as mpt

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted(ROOT.glob("notebooks/*.ipynb"))
AXIS = mpt.gsm_axis(dt=1.0, q=0.01, r=0.1)
MODELS_2016 = {"cv": mpt.constant_velocity(1.0, 0.01, 0.1), "ca": mpt.constant_acceleration(1.0, 0.01, 0.1)}
# What the first screen of a notebook and the README call the verdicts.
COUNTED = {
    "reproduced": "reproduced",
    "within band": "within band",
    "errata": "erratum",
    "differs": "differs",
    "cannot be checked": "cannot be checked",
}


def dense_model(seed, n=3, m=2):
    """A model whose matrices have no zeros: correlated noises, a start that is uncertain, stable or not."""
    rng = np.random.default_rng(seed)
    roots = [rng.standard_normal((size, size)) for size in (n, m, n)]
    Q, R, P0 = (root @ root.T + 0.1 * np.eye(len(root)) for root in roots)
    x0 = rng.standard_normal(n)
    return mpt.LinearModel(F=rng.standard_normal((n, n)), H=rng.standard_normal((m, n)), Q=Q, R=R, x0=x0, P0=P0)


@pytest.fixture(
    params=[(axes, p0) for axes in (1, 2, 3) for p0 in (0.0, 100.0)], ids=lambda p: f"{p[0]}axes-P0={p[1]:g}"
)
def axis_and_count(request):
    """One axis of the papers' models with a start that is not zero, and how many axes there are."""
    axes, p0 = request.param
    return replace(AXIS, x0=[3.0, -1.0], P0=p0 * np.eye(2)), axes


@pytest.fixture
def model(axis_and_count):
    """Model A over one to three axes."""
    axis, axes = axis_and_count
    return mpt.stack(*[axis] * axes)


@pytest.fixture
def z(model):
    """Measurements of one track of 60 steps."""
    return mpt.simulate(model, 60, np.random.default_rng(7))[1]


@pytest.fixture(params=NOTEBOOKS, ids=lambda path: path.stem)
def notebook(request):
    """A committed notebook: its key and its cells."""
    return request.param.stem, json.loads(request.param.read_text(encoding="utf-8"))["cells"]
