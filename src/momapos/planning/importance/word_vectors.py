"""Read word vectors from a file in the text format of GloVe and word2vec."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import FileFormatError, open_regular

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_LINE = 1 << 16
"""Longest line [bytes]: a word and several thousand numbers."""
MAX_SHOWN = 40
"""Number of characters of a word that messages show [-]."""


def read_word_vectors(path: Path, wanted: Collection[str]) -> dict[str, Float[np.ndarray, " d"]]:
    """Read the vectors of some words in one pass, without loading the whole file.

    Args:
        path: File with a word and its numbers per line, separated by spaces. The first line may
            hold the number of words and of dimensions, as word2vec writes it.
        wanted: Words in lower case.

    Returns:
        Vectors of one length by word, without words that are not in the file.

    Raises:
        FileFormatError: The file cannot be read, or a line is invalid; the message names the line.
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
                continue  # the header of word2vec
            if dimensions is None:
                dimensions = len(rest.split())
            word = left.pop(first, None)
            if word is not None:
                found[word] = _vector(
                    rest, dimensions, f"{path}, line {number}: {word[:MAX_SHOWN]!r}"
                )
    return found


def _line(read: Callable[[int], bytes], path: Path, number: int) -> bytes:
    try:
        line = read(MAX_LINE)
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read ({error.strerror})") from error
    if len(line) >= MAX_LINE:
        raise FileFormatError(
            f"{path}, line {number}: longer than {MAX_LINE} bytes; each line must have a word and "
            "its numbers"
        )
    return line


def _vector(text: bytes, dimensions: int, where: str) -> Float[np.ndarray, " d"]:
    try:
        numbers = [float(part) for part in text.split()]
    except ValueError as error:
        raise FileFormatError(f"{where} must be followed by numbers only") from error
    if not numbers or len(numbers) != dimensions:
        raise FileFormatError(
            f"{where} has {len(numbers)} numbers; the file's first word has {dimensions}"
        )
    if not all(map(math.isfinite, numbers)):
        raise FileFormatError(f"{where} has a number that is not finite")
    return np.array(numbers)
