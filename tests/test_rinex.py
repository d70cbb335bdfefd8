"""The code of the page "From RINEX to a filtered track" runs in order, and prints what the page says."""

import re
import sys

import numpy as np
from conftest import ROOT

sys.path.insert(0, str(ROOT / "notebooks" / "data"))
import make_table

BLOCKS = re.findall(r"(?ms)^```(\w+)\n(.*?)^```$", (ROOT / "docs" / "rinex.md").read_text(encoding="utf-8"))


def test_the_code_prints_what_the_page_says(monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    names, printed = {}, ""
    for kind, text in BLOCKS:
        if kind == "python":
            assert printed == "", "the page does not say what the block before prints"
            exec(text, names)
            printed = capsys.readouterr().out
        elif kind == "text":
            assert printed == text
            printed = ""
    assert printed == ""


def test_the_script_computes_what_the_page_does_by_hand(monkeypatch):
    monkeypatch.chdir(ROOT)
    page = {}
    for text in [text for kind, text in BLOCKS if kind == "python"][:5]:
        exec(text, page)
    names = ["M0", "Cuc", "Cus", "Cic", "Cis", "Crs", "Crc", "omega", "TGD"]
    message = {name: page[name] for name in names}
    message |= {"Toe": page["toe"], "Eccentricity": page["e"], "sqrtA": page["sqrt_a"], "DeltaN": page["dn"]}
    message |= {"Omega0": page["node0"], "OmegaDot": page["node_rate"], "Io": page["i0"], "IDOT": page["i_rate"]}
    message |= {"SVclockBias": page["a0"], "SVclockDrift": page["a1"], "SVclockDriftRate": page["a2"]}
    left = page["t"] - page["C1C"] / make_table.C - page["clock"]
    position, clock = make_table.orbit(message, np.array([left]))
    np.testing.assert_allclose(position[0], page["at_transmission"], rtol=0, atol=1e-6)
    np.testing.assert_allclose(clock[0], page["clock"], rtol=1e-9)
    travel = np.linalg.norm(position - page["station"], axis=1) / make_table.C
    np.testing.assert_allclose(make_table.turned(position, travel)[0], page["satellite"], rtol=0, atol=1e-6)
