"""`plot.axes_table`."""

import pytest

import oitlab
from oitlab import plot
from plotting import of_kind


def test_axes_table_holds_every_cell() -> None:
    figure = plot.axes_table()
    table = oitlab.techniques().axes_table()
    words = "".join(t.get_text() for t in figure.texts).replace(" ", "")
    for row in table.rows:
        assert "".join(row[0].split()) in words
    found = sorted("".join(t.get_text().replace(" ", "") for t in figure.texts))
    assert found == sorted(
        "".join(cell for row in (table.columns, *table.rows) for cell in row).replace(" ", "")
    )


def test_axes_table_of_some() -> None:
    figure = plot.axes_table(["mlab", "over"])
    assert [t.get_text() for t in of_kind(figure.texts, "id")] == ["mlab", "a_buffer"]
    for wrong, message in (
        (["nothing"], "unknown technique 'nothing'; known: a_buffer"),
        ([], "techniques is empty"),
        (3, "techniques must be one or several, got 3"),
        (["over", "a_buffer"], "techniques has 'a_buffer' twice"),
    ):
        with pytest.raises(ValueError, match=message):
            plot.axes_table(wrong)
    with pytest.raises(ValueError, match=r"width must be at least \d"):
        plot.axes_table(width="single")
