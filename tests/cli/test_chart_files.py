"""`replay --png` and `--svg`: the chart of the page as a file."""

from __future__ import annotations

import struct
from pathlib import Path
from xml.etree import ElementTree

from command import called

HOVER = "time_s,voltage_V,current_A\n" + "".join(
    f"{k},{16.2 - 0.002 * k:.3f},{0.1 if k < 5 else 18}\n" for k in range(90)
)
REST = "time_s,voltage_V,current_A\n" + "".join(f"{k},16.2,0.1\n" for k in range(90))
STATED = ("--capacity-ah", "5")


def test_both_kinds_of_picture_are_what_they_say(tmp_path: Path) -> None:
    (tmp_path / "f.csv").write_text(HOVER)
    done = called("replay", "f.csv", *STATED, "--png", "f.png", "--svg", "f.svg", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    png = (tmp_path / "f.png").read_bytes()
    assert png.startswith(b"\x89PNG") and struct.unpack(">II", png[16:24])[0] > 1500
    svg = (tmp_path / "f.svg").read_text()
    assert ElementTree.fromstring(svg).tag.endswith("svg")
    assert "time left (min)" in svg and "f.csv: The log ends in the air with" in svg


def test_several_logs_fill_a_folder(tmp_path: Path) -> None:
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text(HOVER)
    assert called("replay", "a.csv", "b.csv", *STATED, "--svg", "charts", folder=tmp_path).returncode == 0
    assert {p.name for p in (tmp_path / "charts").iterdir()} == {"a.svg", "b.svg"}


def test_without_a_forecast_there_is_nothing_to_draw(tmp_path: Path) -> None:
    (tmp_path / "f.csv").write_text(REST)
    done = called("replay", "f.csv", *STATED, "--png", "f.png", folder=tmp_path)
    assert done.returncode == 0 and "f.png: not written" in done.stderr and not (tmp_path / "f.png").exists()
