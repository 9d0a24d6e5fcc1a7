"""What a search for a head has come to."""

from __future__ import annotations

from posetrack_cli.head.initialisation.search import NO_FACE, InitFailure, Search


def after(*failures: InitFailure) -> Search:
    search = Search()
    for failure in failures:
        search = search.failed(failure)
    return search


def test_it_says_how_many_frames_the_best_score_and_the_usual_reason() -> None:
    search = after(
        InitFailure(NO_FACE, 0.1), InitFailure("6 of 10 points matched", 0.31), InitFailure(NO_FACE, 0.2)
    )
    assert str(search) == "3 frames searched, best score 0.31, mostly: no face"
    assert str(after(InitFailure(NO_FACE))) == "1 frame searched, best score 0.00, mostly: no face"
    assert str(Search()) == "0 frames searched, best score 0.00"


def test_images_are_exchanged_when_frames_in_a_row_say_so_and_faceless_ones_do_not_count() -> None:
    exchanged = InitFailure("exchanged", 0.5, (1, 0))
    assert after(exchanged, InitFailure(NO_FACE), exchanged, exchanged).images_swapped
    assert not after(exchanged, exchanged).images_swapped
    assert not after(exchanged, exchanged, InitFailure("else", 0.5), exchanged).images_swapped
