"""Word vectors from files: both text formats, and invalid files."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from tests.commands import error_of, output_of
from tests.planning.importance.small_rooms import box, room

from momapos.core.errors import FileFormatError, InputError
from momapos.model.scene.scene import Scene
from momapos.planning.importance.config import ImportanceConfig
from momapos.planning.importance.ranking import rank
from momapos.planning.importance.scorers import MAX_LINE, MIN_SCORE, read_word_vectors

GLOVE = "the 0.1 0.2 0.3\nfridge 1 0 0\ncup 0.6 0.8 0\nshoe -1 0 0\n"


@pytest.fixture
def kitchen() -> Scene:
    names = ("fridge", "cup_1", "shoe", "gadget")
    return room(*(box(n, (0.1, 0.1, 0.1), (float(k), 0.0, 0.0)) for k, n in enumerate(names)))


@pytest.mark.parametrize("head", ["", "4 3\n"])
def test_files_with_and_without_a_header_are_read(head: str, tmp_path: Path) -> None:
    path = tmp_path / "vectors.txt"
    path.write_text(head + GLOVE)
    found = read_word_vectors(path, {"cup", "fridge", "spoon"})
    assert set(found) == {"cup", "fridge"}
    np.testing.assert_array_equal(found["cup"], [0.6, 0.8, 0.0])


def test_scores_are_cosines_of_the_vectors_in_the_file(kitchen: Scene, tmp_path: Path) -> None:
    path = tmp_path / "vectors.txt"
    path.write_text(GLOVE)
    found = rank(kitchen, "fridge", ImportanceConfig(scorer="names", vectors=str(path)))
    assert found.score("cup_1") == pytest.approx(0.6)
    assert found.score("shoe") == MIN_SCORE == found.score("gadget")
    with pytest.raises(InputError, match="has none of the target's words: gadget"):
        rank(kitchen, "gadget", ImportanceConfig(scorer="names", vectors=str(path)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("fridge 1 x 0\n", "line 1: 'fridge' must be followed by numbers only"),
        ("the 1 2\nfridge 1 2 3\n", "line 2: 'fridge' has 3 numbers; the file's first word has 2"),
        ("fridge\n", "'fridge' has 0 numbers"),
        ("fridge 1 inf 0\n", "not finite"),
        ("a" * MAX_LINE, "line 1: longer than"),
    ],
)
def test_an_invalid_line_is_reported(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "vectors.txt"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=message):
        read_word_vectors(path, {"fridge"})


def test_a_fifo_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(FileFormatError, match="is a fifo"):
        read_word_vectors(tmp_path / "fifo", {"fridge"})


def test_rank_reads_vectors_from_a_setting(tmp_path: Path) -> None:
    path = tmp_path / "vectors.txt"
    path.write_text(GLOVE)
    command = ["rank", "kitchen_small", "fridge", "--set", f"importance.vectors={path}"]
    assert "cup" in output_of(*command, "--scorer", "names")
    assert "importance.vectors needs the scorer names" in error_of(*command)
    missing = f"importance.vectors={tmp_path / 'none.txt'}"
    assert "none.txt: no such file" in error_of(*command[:-1], missing, "--scorer", "names")
