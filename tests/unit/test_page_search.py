"""The search's page: where the supplement's best stands, chance, and what a winner is worth."""

from __future__ import annotations

import pytest
from drawn import assert_readable, texts

from silem import paper
from silem.report.pages import search
from silem.study.studies import Ranked


def entry(returns: list[float], best: bool = False, fresh: tuple[float, ...] = ()) -> Ranked:
    """One configuration, told apart by its minibatch; 64 is the supplement's."""
    settings = {"n_epochs": 5 if sum(returns) > 150 else 10, "minibatch_size": 64 if best else 128}
    score = sum(returns) / len(returns)
    return Ranked(settings, score, tuple(returns), best, fresh)


RANKED = [
    entry([100.0, 102.0], fresh=(60.0, 61.0, 62.0)),
    entry([80.0, 81.0], best=True, fresh=(80.0, 80.0, 81.5)),
    entry([20.0, 22.0]),
]


def test_the_supplements_place_and_chance_are_told() -> None:
    said = search.says(RANKED, 24)
    assert said.startswith("3 of 24 configurations have all their trials.")
    assert "is on place 2 of 3" in said and "differ by more than" in said and "of 1.00." in said
    noise = [entry([100.0, 0.0]), entry([0.0, 98.0], best=True), entry([50.0, 46.0])]
    assert "do not differ by more" in search.says(noise, 3)
    assert "cannot tell" in search.says([entry([3.0]), entry([2.0])], 2)
    assert "is not among them" in search.says([RANKED[0], RANKED[2]], 3)
    for few in ([], RANKED[:1]):
        assert "not run yet" in search.says(few, 3)


def test_a_winner_is_worth_what_fresh_seeds_say() -> None:
    winner, supplement, last = search.table(RANKED).data["change [95 %]"]
    assert winner.startswith("−40 [−4") and winner.endswith("]")
    assert supplement.startswith("0 [") and last == "–"

    said = search.curse(RANKED, "HC2")
    assert said.startswith("On HC2 the winner goes from 101 to 61 on 3 fresh seeds, the supp")
    assert said.endswith("from 80 to 80 on 3 fresh seeds.")
    for few in ([], RANKED[2:]):
        assert search.curse(few, "HC2") == "On HC2 nothing has been run on fresh seeds yet."


def test_the_table_names_settings_as_the_paper_does() -> None:
    table = search.table(RANKED).data
    assert {"N_P", "N_Pmb"} <= set(table) & set(paper.symbols())
    assert list(table["place"]) == ["1", "2 (supplement)", "3"]
    assert list(table["N_Pmb"]) == ["128", "64", "128"]
    assert table["on fresh seeds"][0] == "60; 61; 62"
    assert list(search.table([]).data["place"]) == ["not run yet"]


@pytest.mark.parametrize("ranked", [RANKED, []])
def test_each_setting_that_was_varied_has_a_plot(ranked: list[Ranked]) -> None:
    figure = search.sensitivity(ranked, "SILEM on HC2")
    if not ranked:
        assert "no run" in texts(figure)
        return
    assert_readable(figure)
    epochs, minibatch = figure.axes
    assert "N_P" in epochs.get_title(loc="left") and "N_Pmb" in minibatch.get_title(loc="left")
    means = [line.get_ydata()[0] for line in minibatch.lines if len(set(line.get_xdata())) == 2]
    assert means == [80.5, 61.0]  # of 64, and of the two with 128
