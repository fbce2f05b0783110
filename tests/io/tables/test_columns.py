"""One-column CSV files are read strictly, and say which line is wrong."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from napari_elsplus.errors import InputError
from napari_elsplus.io import read_depths_um, read_volts, volts_beside, write_column, write_table


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=9))
def test_every_digit_comes_back(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("csv") / "depths.csv"
    write_column(path, "depth_um", values)
    np.testing.assert_array_equal(read_depths_um(path), values)


def test_what_numpy_and_spreadsheets_write_is_read(tmp_path):
    np.savetxt(tmp_path / "a.csv", [1, 2.5], header="volts", comments="")
    (tmp_path / "b.csv").write_bytes(b"\xef\xbb\xbfvolts\r\n1\r\n2.5\r\n\r\n")
    for name in ("a.csv", "b.csv"):
        np.testing.assert_array_equal(read_volts(tmp_path / name), [1, 2.5])


@pytest.mark.parametrize("name", ["sweep", "sweep 2026.01.05", "0.5 um"])
@pytest.mark.parametrize("suffix", [".tif", ".ome.tif"])
def test_voltages_lie_beside_a_sweep_under_its_whole_name(tmp_path, name, suffix):
    table = tmp_path / f"{name}_volts.csv"
    assert volts_beside(tmp_path / (name + suffix)) is None
    write_column(table, "volts", [1.0])
    assert volts_beside(tmp_path / (name + suffix)) == table


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "line 1 is nothing"),
        ("1\n2\n", "line 1 is '1'"),
        ("volts\n1\n", "line 1 is 'volts'"),
        ("depth_um\n1_0\n", "line 2 is '1_0'"),
        ("depth_um\n", "no number"),
        ("depth_um\n1\nx\n", "line 3 is 'x'"),
        ("depth_um\n1\n\n2\n", "line 3 is ''"),
        ("depth_um\nnan\n", "line 2 is 'nan'"),
        ("depth_um\n1,2\n", "line 2 is '1,2'"),
    ],
)
def test_anything_else_is_refused_by_its_line(tmp_path, text, said):
    (tmp_path / "d.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        read_depths_um(tmp_path / "d.csv")


def test_missing_and_foreign_files(tmp_path):
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe")
    for name in ("b.csv", "absent.csv", "."):
        with pytest.raises(InputError):
            read_volts(tmp_path / name)


def test_curves_of_different_lengths_share_a_table(tmp_path):
    write_table(tmp_path / "t.csv", {"position_um": [0.0, 0.1, 0.30000000000000004], "ls": np.array([1, 2])})
    assert (tmp_path / "t.csv").read_text() == "position_um,ls\n0.0,1.0\n0.1,2.0\n0.30000000000000004,\n"
    with pytest.raises(InputError, match="exists"):
        write_table(tmp_path / "t.csv", {})
