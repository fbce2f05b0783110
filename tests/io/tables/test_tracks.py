"""Tracks survive their file to the last digit."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from napari_elsplus.errors import InputError
from napari_elsplus.io import TrackPoint, read_track, write_track

HEADER = "frame,time_s,segment,row_px,col_px,row_um,col_um,score,sigma_px,state"
POINT = TrackPoint(0, 0.0, 0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, "tracked")
number = st.floats(allow_infinity=False)
points = st.builds(
    TrackPoint, st.integers(0, 10**9), number, st.integers(0, 99), number, number, number, number, number, number,
    st.sampled_from(["tracked", "predicted", "lost"]),
)  # fmt: skip


def same(a, b):
    return all(x == y or (isinstance(x, float) and math.isnan(x) and math.isnan(y)) for x, y in zip(a, b, strict=True))


@given(st.lists(points, max_size=5))
def test_every_digit_and_nan_comes_back(tmp_path_factory, track):
    path = tmp_path_factory.mktemp("track") / "track.csv"
    write_track(path, track)
    assert path.read_text().splitlines()[0] == HEADER
    read = read_track(path)
    assert len(read) == len(track)
    assert all(map(same, track, read))


def test_lost_positions_are_written_as_nan(tmp_path):
    lost = POINT._replace(row_px=math.nan, col_px=math.nan, state="lost")
    write_track(tmp_path / "track.csv", [lost])
    assert (tmp_path / "track.csv").read_text().splitlines()[1] == "0,0.0,0,nan,nan,0.0,0.0,1.0,0.0,lost"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "header ''"),
        ("a,b\n", "header 'a,b'"),
        (HEADER + "\n0,0,0,0,0,0,0,1,0,tracked\n1,0,0,x,0,0,0,1,0,tracked\n", "line 3"),
        (HEADER + "\n0,0,0,0,0,0,0,1,0,found\n", "line 2"),
        (HEADER + "\n0,0\n", "line 2"),
    ],
)
def test_what_is_no_track_is_refused(tmp_path, text, said):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        read_track(tmp_path / "t.csv")


def test_an_unknown_state_leaves_no_file(tmp_path):
    with pytest.raises(InputError, match="state 'found'"):
        write_track(tmp_path / "t.csv", [POINT, POINT._replace(state="found")])
    assert list(tmp_path.iterdir()) == []


def test_missing_and_foreign_files(tmp_path):
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe")
    for name in ("b.csv", "absent.csv", "."):
        with pytest.raises(InputError):
            read_track(tmp_path / name)
