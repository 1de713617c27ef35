"""Word vectors from a file of the user's, in the text format of GloVe and word2vec."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import FileFormatError, open_regular

if TYPE_CHECKING:
    from jaxtyping import Float

LONGEST = 1 << 16
"""Bytes of a line at most: a word and some thousand numbers."""
SHOWN = 40
"""Characters of a word that messages repeat."""


def read_word_vectors(path: Path, wanted: Collection[str]) -> dict[str, Float[np.ndarray, " d"]]:
    """The vectors of some words; the file is passed through once and not kept.

    Args:
        path: A word and its numbers a line, between blanks; the line before the first word may hold
            how many words and numbers there are, as word2vec writes it.
        wanted: Words in lower case.

    Returns:
        Vectors of one length, by word; words that the file lacks are left out.

    Raises:
        FileFormatError: It cannot be read, or a line is none of such a file; the message says
            which.
    """
    left = {word.encode(): word for word in wanted}
    found: dict[str, Float[np.ndarray, " d"]] = {}
    dimensions = None
    with open_regular(path) as file:
        number = 0
        while left and (line := _line(file.readline, path, number + 1)):
            number += 1
            first, _, rest = line.rstrip().partition(b" ")
            if number == 1 and first.isdigit() and rest.isdigit():
                continue  # the head that word2vec writes
            if dimensions is None:
                dimensions = len(rest.split())
            word = left.pop(first, None)
            if word is not None:
                found[word] = _vector(rest, dimensions, f"{path}, line {number}: {word[:SHOWN]!r}")
    return found


def _line(read: Callable[[int], bytes], path: Path, number: int) -> bytes:
    try:
        line = read(LONGEST)
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read ({error.strerror})") from error
    if len(line) >= LONGEST:
        raise FileFormatError(
            f"{path}, line {number}: longer than {LONGEST} bytes; word vectors are text, a "
            "word and its numbers a line"
        )
    return line


def _vector(text: bytes, dimensions: int, where: str) -> Float[np.ndarray, " d"]:
    try:
        numbers = [float(part) for part in text.split()]
    except ValueError as error:
        raise FileFormatError(f"{where} is followed by what is no number") from error
    if not numbers or len(numbers) != dimensions:
        raise FileFormatError(
            f"{where} has {len(numbers)} numbers, and the file's first word {dimensions}"
        )
    if not all(map(math.isfinite, numbers)):
        raise FileFormatError(f"{where} has a number that is not finite")
    return np.array(numbers)
