"""File dialogs of the panels, their answers given by the test."""

from __future__ import annotations

from napari_elsplus.widgets.shared.files import choose_file_to_write

KINDS = "Pictures (*.png);;Tables (*.csv)"


def test_a_name_without_a_suffix_has_that_of_the_chosen_kind_and_replaces_no_file_unasked(tmp_path, monkeypatch):
    """Before: an error asked for the suffix, and the name was to be typed again."""
    (tmp_path / "there.csv").write_text("x")
    typed = ["new", "there", "there.csv", "2026.01.05 skin.png", ""]
    suggested, written = [], []

    def answer(_parent, _title, name, _kinds):
        suggested.append(name)
        name = typed.pop(0)
        return (str(tmp_path / name) if name else "", "Tables (*.csv)")

    monkeypatch.setattr("napari_elsplus.widgets.shared.files.QFileDialog.getSaveFileName", answer)
    for _ in range(4):
        choose_file_to_write(None, "Save", "plot.png", KINDS, written.append)
    assert [path.name for path in written] == ["new.csv", "there.csv", "2026.01.05 skin.png"]
    assert suggested[2] == str(tmp_path / "there.csv"), "asked again, by which the dialog asks before it is replaced"
    assert typed == []
