"""`plot.pareto`: error against cost, and names that do not cover each other."""

import re
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from oitlab import plot
from plotting import legend, of_kind, prices, shown, texts


def front(figure: Figure) -> list[tuple[float, float]]:
    (line,) = of_kind(figure.axes[0].lines, "front")
    return list(zip(line.get_xdata(), line.get_ydata(), strict=True))


def labels(figure: Figure) -> list[Text]:
    return of_kind(figure.axes[0].texts, "label")


def test_pareto_draws_the_front() -> None:
    figure = plot.pareto(prices())
    assert front(figure) == [(1, 1e-2), (2, 1e-3), (8, 1e-4), (16, 0)]
    assert sorted(t.get_text() for t in labels(figure)) == ["a_buffer", "lwboit", "mlab", "wboit"]
    axes = figure.axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("time in all (ms)", "MSE (linear RGB, squared)")
    beaten, best = of_kind(axes.lines, "points")
    assert beaten.get_xdata().tolist() == [4.0]
    assert best.get_xdata().tolist() == [1, 2, 8]
    (edge,) = of_kind(axes.lines, "edge")
    assert edge.get_xdata()[0] == 16
    assert "triangle on the edge of y: 1e-14 or less" in shown(figure)
    assert front(plot.pareto(prices(), "bytes_per_pixel")) == [
        (20, 1e-2),
        (40, 2e-3),
        (80, 1e-3),
        (160, 1e-4),
        (320, 0),
    ]


def test_pareto_takes_more_psnr_for_better() -> None:
    table = prices().assign(psnr=[20.0, 30.0, 25.0, 40.0, np.inf])
    assert front(plot.pareto(table, y="psnr", logy=False)) == [(1, 20), (2, 30), (8, 40), (16, np.inf)]


def test_pareto_keeps_equals_and_points_alike() -> None:
    table = pd.DataFrame({"technique": ["a", "b", "c"], "total_ms": [1.0, 1.0, 1.0], "mse": [0.1, 0.1, 0.2]})
    figure = plot.pareto(table)
    assert sorted(t.get_text() for t in labels(figure)) == ["a", "b"]


def test_pareto_sums_seeds_up() -> None:
    table = pd.concat([prices().assign(seed=s, mse=prices()["mse"] * (1 + s)) for s in (0, 1, 2)])
    figure = plot.pareto(table)
    assert front(figure)[0] == (1, 2e-2)
    spread = of_kind(figure.axes[0].collections, "spread")[-1].get_segments()[0]
    assert spread[:, 1] == pytest.approx([1e-2, 3e-2])


def test_pareto_names_no_param_that_is_merely_inactive_in_some_rows() -> None:
    table = pd.DataFrame(
        {
            "technique": "wboit",
            "weight": ["one", "mb7", "mb10"],
            "weight_scale": [None, 1.0, 1.0],
            "near": [None, None, 0.1],
            "total_ms": [3.0, 2.0, 1.0],
            "mse": [0.01, 0.1, 0.2],
        }
    )
    assert {t.get_text() for t in labels(plot.pareto(table))} == {
        "wboit weight=one",
        "wboit weight=mb7",
        "wboit weight=mb10",
    }
    alone = table.assign(weight="mb7", near=None)[:2]
    assert {t.get_text() for t in labels(plot.pareto(alone))} == {"wboit", "wboit weight_scale=1"}


def test_pareto_names_variants_by_what_differs() -> None:
    table = pd.DataFrame(
        {
            "technique": ["lwboit", "lwboit", "wboit"],
            "bins": [4, 8, None],
            "weight": ["mb7", "mb7", "mb7"],
            "total_ms": [2.0, 3.0, 1.0],
            "mse": [0.01, 0.001, 0.1],
        }
    )
    assert sorted(t.get_text() for t in labels(plot.pareto(table))) == [
        "lwboit bins=4",
        "lwboit bins=8",
        "wboit",
    ]
    hued = plot.pareto(table, hue="technique", labels="none")
    assert not labels(hued)
    assert legend(hued) == ["Pareto front", "lwboit", "wboit", "hollow: beaten"]
    with pytest.raises(ValueError, match="rows of one point differ in 'bins'"):
        plot.pareto(table, name="technique")


def boxes_of(figure: Figure) -> list[tuple[str, Any]]:
    figure.draw_without_rendering()
    return [(t.get_text(), Text.get_window_extent(t)) for t in labels(figure)]


@pytest.mark.parametrize("width", ["single", "double"])
def test_names_cover_neither_each_other_nor_points_nor_the_edge(width: Any) -> None:
    random = np.random.default_rng(7)
    time = np.exp(random.uniform(0, 2, 40))
    table = pd.DataFrame(
        {
            "technique": [f"technique_{i}" for i in range(40)],
            "total_ms": time,
            "mse": 1e-2 * time**-3 * np.exp(random.uniform(0, 2, 40)),
        }
    )
    figure = plot.pareto(table, labels="all", width=width)
    boxes = boxes_of(figure)
    axes = figure.axes[0]
    window = axes.get_window_extent()
    points = axes.transData.transform(table[["total_ms", "mse"]].to_numpy())
    assert len(boxes) >= 8
    for index, (name, box) in enumerate(boxes):
        assert window.x0 <= box.x0 + 1, name
        assert box.x1 <= window.x1 + 1, name
        assert window.y0 <= box.y0 + 1, name
        assert box.y1 <= window.y1 + 1, name
        for other, its in boxes[index + 1 :]:
            assert not box.overlaps(its), (name, other)
        assert not any(box.contains(*point) for point in points), name
    # what found no room is listed, word for word, or counted where the list ends
    (note,) = [text.get_text() for text in texts(figure) if text.get_gid() == "note"]
    more = re.search(r"(\d+)\smore$", note)
    named = {name for name, _ in boxes} | set(re.findall(r"technique_\d+", note))
    assert len(table) - len(named) == (int(more[1]) if more else 0)
    again = [t.get_position() for t in labels(plot.pareto(table, labels="all", width=width))]
    assert again == [t.get_position() for t in labels(figure)]


def test_the_front_is_named_before_others() -> None:
    table = pd.DataFrame(
        {"technique": [f"a_long_name_{i:02}" for i in range(60)], "total_ms": 1.0 + 1e-4 * np.arange(60)}
    )
    table["mse"] = [0.0101] * 59 + [0.01]
    figure = plot.pareto(table, labels="all", width="single")
    named = [t.get_text() for t in labels(figure)]
    assert {"a_long_name_00", "a_long_name_59"} <= set(named)
    assert len(named) < 60


def test_pareto_counts_what_is_missing_and_refuses_nothing_but_that() -> None:
    table = prices()
    table.loc[2, "mse"] = np.nan
    assert "not drawn: 1 missing (NaN)" in shown(plot.pareto(table))
    with pytest.raises(ValueError, match="no row has numbers in both 'total_ms' and 'mse'"):
        plot.pareto(table.assign(mse=np.nan))
    with pytest.raises(ValueError, match="labels must be one of"):
        plot.pareto(prices(), labels="some")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="no column 'ms'; it has: technique, total_ms"):
        plot.pareto(prices(), x="ms")
    with pytest.raises(ValueError, match="'total_ms' holds -1 in row 0"):
        plot.pareto(prices().assign(total_ms=-1.0))


def test_names_without_room_are_listed_in_a_few_lines() -> None:
    count = 300
    table = pd.DataFrame(
        {
            "technique": [f"technique_{index}" for index in range(count)],
            "total_ms": 1 + np.arange(count) / count,
            "mse": 1.0,
        }
    )
    figure = plot.pareto(table, labels="all", width="single")
    (note,) = [t.get_text() for t in figure.axes[0].texts if t.get_gid() == "note"]
    assert len(note.splitlines()) <= 4
    flat = note.replace("\n", " ")
    listed = flat.removeprefix("not named, for lack of room: ").split(", ")
    more = re.search(r" and (\d+) more$", flat)
    assert more
    written = sum(t.get_text() in set(table["technique"]) for t in figure.axes[0].texts)
    assert written + len(listed) + int(more[1]) == count
