"""The 80 classes of COCO, in the order of detectors, and our labels for them."""

from __future__ import annotations

from collections.abc import Mapping

COCO80: tuple[str, ...] = (
    "person", "bicycle", "car", "motorcycle", "airplane", "bus", "train", "truck", "boat",
    "traffic light", "fire hydrant", "stop sign", "parking meter", "bench", "bird", "cat", "dog",
    "horse", "sheep", "cow", "elephant", "bear", "zebra", "giraffe", "backpack", "umbrella",
    "handbag", "tie", "suitcase", "frisbee", "skis", "snowboard", "sports ball", "kite",
    "baseball bat", "baseball glove", "skateboard", "surfboard", "tennis racket", "bottle",
    "wine glass", "cup", "fork", "knife", "spoon", "bowl", "banana", "apple", "sandwich",
    "orange", "broccoli", "carrot", "hot dog", "pizza", "donut", "cake", "chair", "couch",
    "potted plant", "bed", "dining table", "toilet", "tv", "laptop", "mouse", "remote",
    "keyboard", "cell phone", "microwave", "oven", "toaster", "sink", "refrigerator", "book",
    "clock", "vase", "scissors", "teddy bear", "hair drier", "toothbrush",
)  # fmt: skip
"""Class names by class number of a detector trained on COCO."""

GAPS = frozenset((12, 26, 29, 30, 45, 66, 68, 69, 71, 83))
"""Numbers from 1 to 90 that COCO's files don't use."""
CATEGORIES: Mapping[int, str] = dict(
    zip((number for number in range(1, 91) if number not in GAPS), COCO80, strict=True)
)
"""Class names by the `category_id` of COCO's files, such as Detectron2's results."""

RENAMED: Mapping[str, str] = {
    "dining table": "table",
    "refrigerator": "fridge",
    "tv": "screen",
    "potted plant": "plant",
}
"""Our labels, where they differ from COCO's."""
INDOORS = frozenset((
    "backpack", "umbrella", "handbag", "suitcase", "bottle", "wine glass", "cup", "fork", "knife",
    "spoon", "bowl", "banana", "apple", "orange", "bench", "chair", "couch", "potted plant", "bed",
    "dining table", "toilet", "tv", "laptop", "mouse", "remote", "keyboard", "cell phone",
    "microwave", "oven", "toaster", "sink", "refrigerator", "book", "clock", "vase", "scissors",
))  # fmt: skip
"""Classes of objects in homes, without people, animals, traffic and meals."""
LABELS: frozenset[str] = frozenset(RENAMED.get(name, name) for name in INDOORS)
"""All labels of a detector of COCO's classes."""


WITHOUT_DOORS: frozenset[str] = LABELS - {"fridge", "oven", "microwave", "sink", "table"}
"""Labels of objects without doors and drawers."""


def label_of_class(index: int) -> str:
    """Return our label for a class of COCO; "" for other classes and numbers."""
    return label_of_name(COCO80[index]) if 0 <= index < len(COCO80) else ""


def label_of_name(name: str) -> str:
    """Return our label for a class name of any detector; "" for those of COCO not in homes."""
    name = name.strip().lower()
    return "" if name in COCO80 and name not in INDOORS else RENAMED.get(name, name)
