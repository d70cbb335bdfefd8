"""The numbers of the home page: which filter to take, the cost of three mistakes in metres, the papers' outcomes.

Each number is computed here, by the package or from the verdicts; the words and the names of the figures stand in
papers.toml.
"""

from typing import NamedTuple

import break_sensor
import numpy as np

import mpt_helpers as mpt
from reproduction import burden
from reproduction.ledger.verdicts import OF_CLAIMS, OF_VALUES

AXES = 2  # operations are those of a track in the plane
SPEED_2016 = 20.0  # m/s, the paper's example


class Outcome(NamedTuple):
    """How many items of a paper come out alike: the verdict that colours them, the words, and the number."""

    verdict: str
    words: str
    count: int


def choice():
    """Return the numbers of the answer and of the table of filters: operations in the plane, and when each is right."""
    fir = break_sensor.filters()[2]
    gap = break_sensor.SCENES["gap"]
    seen = break_sensor.run(gap, break_sensor.average())
    first = max(gap.lost)
    kalman = AXES * burden.total(burden.kalman(2, 1))
    steady = AXES * burden.total(burden.steady_state(2, 1))
    of_fir = AXES * burden.total(burden.fir(2, 1, fir.order))
    return {
        "kalman": kalman,
        "constant": steady,
        "fir": of_fir,
        "settled": break_sensor.settled(),
        # A constant gain that collects its measurements takes them in one product: FIR must take no more than that.
        "every": next(L for L in range(1, fir.order + 10) if AXES * burden.total(burden.lifted(2, 1, L)) >= of_fir),
        "near": near(),
        "order": fir.order,
        "lost": len(gap.lost),
        "sigma": f"{seen.sigma[first]:.2f}",
        "sigma_constant": f"{seen.sigma_constant[first]:.2f}",
    }


def near():
    """Return the distance from the origin, in whole tens of metres, within which FIR is off by less than 0.1 sigma."""
    fir, sigma = break_sensor.filters()[2], settled_sigma()
    return 10 * int(0.1 * sigma / abs(fir.taps[:, 0, 0].sum() - 1) / 10)


def settled_sigma(ahead=False):
    """Return sigma of the position that a constant-gain filter states."""
    return float(np.sqrt(break_sensor.filters(ahead)[1].P[0, 0]))


def mistakes():
    """Return the cost of each of the three mistakes, {name: {word: number}}; the words of papers.toml hold them."""
    late = break_sensor.SPEED * break_sensor.DT
    start, settled = start_of_2016()
    lasting = break_sensor.numbers(break_sensor.SCENES["lasting"], break_sensor.average())
    return {
        "lag": {"metres": f"{late:.1f}", "times": f"{late / settled_sigma(ahead=True):.0f}"},
        "start": {"metres": f"{start:.0f}", "settled": f"{settled:.1f}"},
        "lasting": {"metres": f"{lasting['kalman']:.1f}", "states": f"{lasting['states']:.2f}"},
    }


def start_of_2016():
    """Return the largest mean error of 2016's filter at its start, constant velocity, and sigma once it has settled."""
    steady = mpt.SteadyStateFilter.from_kalman(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1))
    truth = mpt.exact_motion(steady.model, x0=[0.0, SPEED_2016])
    mean = mpt.metrics.error_moments(steady, truth, N=50).mean[:, 0]
    return float(np.abs(mean).max()), float(np.sqrt(steady.P[0, 0]))


def outcomes(given):
    """Return how claims and values come out, as Outcomes that add up: {"claims": [...], "values": [...]}."""
    tally = given.tally()
    values = tally.outcomes_of_values()
    return {
        "claims": [Outcome(each, words, tally.claims[each]) for each, words in OF_CLAIMS.items() if tally.claims[each]],
        "values": [Outcome(each, words, values[each]) for each, words in OF_VALUES.items() if values[each]],
    }
