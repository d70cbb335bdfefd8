"""The style of figures: colours and sizes."""

from typing import Any

from cycler import cycler

# Colours: Okabe and Ito, with blue and green darker, so that the first four differ in grey too.
COLOURS = ["#0060A0", "#D55E00", "#008060", "#CC79A7", "#56B4E9", "#E69F00"]
# 11 pt in a figure 5.2 inches wide are 11 pixels on a phone that shows it 380 pixels wide.
SIZES = ["font.size", "axes.titlesize", "axes.labelsize", "xtick.labelsize", "ytick.labelsize", "legend.fontsize"]
STYLE: dict[str, Any] = dict.fromkeys(SIZES, 11) | {
    "savefig.dpi": 130,
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.6,
    "axes.prop_cycle": cycler("color", COLOURS),
}
