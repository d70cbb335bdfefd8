"""What the home page says: which filter to take, what each mistake costs, and what the papers hold.

Each number is computed here, by the package or from the verdicts; the words stand in papers.toml.
"""

import math
import re
from typing import NamedTuple

import break_sensor
import numpy as np

import mpt_helpers as mpt
from reproduction import burden
from reproduction.ledger.verdicts import FAILS, HOLDS, IN_PART

AXES = 2  # operations are those of a track in the plane
SPEED_2016, ACCELERATION_2016 = 20.0, 2.0  # m/s and m/s², the papers' examples


class Mistake(NamedTuple):
    """A mistake with its cost: metres, or for a wrong choice the factor by which a printed number misleads."""

    name: str
    cost: float
    words: dict
    scene: str
    proof: object


def choice():
    """Return the numbers of the table of filters: operations in the plane, and from when on each filter is right."""
    fir = break_sensor.filters()[2]
    steady = AXES * burden.total(burden.steady_state(2, 1))
    of_fir = AXES * burden.total(burden.fir(2, 1, fir.order))
    return {
        "kalman": AXES * burden.total(burden.kalman(2, 1)),
        "constant": steady,
        "fir": of_fir,
        "settled": break_sensor.settled(),
        "after_gap": break_sensor.settled(lost=len(break_sensor.SCENES["gap"].lost)),
        "every": math.ceil(of_fir / steady),
        "near": near(),
    }


def near():
    """Return the distance from the origin, in whole tens of metres, within which FIR is off by less than 0.1 sigma."""
    fir, sigma = break_sensor.filters()[2], settled_sigma()
    return 10 * int(0.1 * sigma / abs(fir.taps[:, 0, 0].sum() - 1) / 10)


def settled_sigma(ahead=False):
    """Return sigma of the position that a constant-gain filter states."""
    return float(np.sqrt(break_sensor.filters(ahead)[1].P[0, 0]))


def in_metres(by_id):
    """Return the mistakes that cost metres, the costliest first."""
    late = break_sensor.SPEED * break_sensor.DT
    gap = break_sensor.SCENES["gap"]
    seen = break_sensor.run(gap, break_sensor.average())
    first = max(gap.lost)
    fir = break_sensor.filters()[2]
    too_far = break_sensor.FAR * abs(fir.taps[:, 0, 0].sum() - 1)
    lasting = break_sensor.numbers(break_sensor.SCENES["lasting"], break_sensor.average())
    found = [
        Mistake(
            "lag",
            late,
            {"metres": f"{late:.1f} m", "times": f"{late / settled_sigma(ahead=True):.0f}"},
            "lag",
            by_id["2014_gsm_2d", "measured"],
        ),
        Mistake(
            "gap",
            seen.sigma_constant[first],
            {
                "metres": f"{seen.sigma_constant[first]:.2f} m",
                "kalman": f"{seen.sigma[first]:.2f} m",
                "lost": len(gap.lost),
                "after": break_sensor.settled(lost=len(gap.lost)),
            },
            "gap",
            by_id["2014_gsm_2d", "behaviour.3"],
        ),
        Mistake(
            "far",
            too_far,
            {"metres": f"{too_far:.1f} m", "km": f"{break_sensor.FAR / 1000:g} km"},
            "far",
            by_id["2014_gsm_2d", "fir.close"],
        ),
        Mistake(
            "lasting",
            lasting["kalman"],
            {"metres": f"{lasting['kalman']:.1f} m", "states": f"{lasting['states']:.2f} m"},
            "lasting",
            by_id["2007_mms_kalman", "line.good"],
        ),
    ]
    return sorted(found, key=lambda mistake: -mistake.cost)


def of_choice(by_id):
    """Return the mistakes that cost a wrong choice, first the one whose printed number misleads most."""
    start, settled = start_of_2016()
    ratios = ratios_of_table_4(by_id)
    wrong = [pair for pair in ratios if pair[2] in FAILS]
    costs = [(float(by_id["2014_gsm_2d", id].printed), float(by_id["2014_gsm_2d", id].computed)) for id in FIR_COSTS]
    worst = max(max(p / c, c / p) for p, c, _, _ in wrong)
    pays = sorted({by_id["2014_gsm_2d", id].printed for id in FIR_PAYS})
    (right,) = {by_id["2014_gsm_2d", id].computed for id in FIR_PAYS}
    found = [
        Mistake(
            "table1",
            start / settled,
            {"start": f"{start:.0f} m", "settled": f"{settled:.1f} m"},
            "",
            by_id["2016_prediction", "cv.estimation.satisfying"],
        ),
        Mistake(
            "table4",
            worst,
            {
                "wrong": len(wrong),
                "all": len(ratios),
                "worst": f"{worst:.1f}",
            },
            "",
            wrong[0][3],
        ),
        Mistake(
            "fir",
            max(computed / printed for printed, computed in costs),
            {"printed": " or ".join(f"{each}" for each in pays), "right": right},
            "",
            by_id["2014_gsm_2d", FIR_PAYS[0]],
        ),
    ]
    return sorted(found, key=lambda mistake: -mistake.cost)


FIR_COSTS = ("table7.fir.a", "table7.fir.b")
FIR_PAYS = ("table7.mu.a", "table7.mu.b")


def ratios_of_table_4(by_id):
    """Return (printed, computed, verdict, the verdict itself) of each ratio of 2014's Table 4 that can be read."""
    cells = [
        each for (key, id), each in by_id.items() if key == "2014_gsm_2d" and re.fullmatch(r"table4\.\d+\.\d+", id)
    ]
    read = [each for each in cells if each.verdict in HOLDS + FAILS]
    return [(float(each.printed), float(each.computed), each.verdict, each) for each in read]


def start_of_2016():
    """Return the largest mean error of 2016's filter at its start, constant velocity, and sigma once it has settled."""
    steady = mpt.SteadyStateFilter.from_kalman(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1))
    truth = mpt.exact_motion(steady.model, x0=[0.0, SPEED_2016])
    mean = mpt.metrics.error_moments(steady, truth, N=50).mean[:, 0]
    return float(np.abs(mean).max()), float(np.sqrt(steady.P[0, 0]))


def outcomes(given):
    """Return how claims and values come out, {"claims": (hold, in part, all), "values": (agree, in part, all)}."""

    def counted(verdicts):
        hold = sum(each.verdict in HOLDS for each in verdicts)
        in_part = sum(each.verdict == IN_PART for each in verdicts)
        return hold, in_part, len(verdicts)

    claims = [each for each in given if each.kind == "claim"]
    return {"claims": counted(claims), "values": counted([each for each in given if each.kind != "claim"])}
