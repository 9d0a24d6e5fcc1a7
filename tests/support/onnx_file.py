"""ONNX files of a network with YuNet's outputs, which are the same whatever the image is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

STRIDES = (8, 16, 32)
CHANNELS = {"cls": 1, "obj": 1, "bbox": 4, "kps": 10}


def yunet_like(
    values: Mapping[str, Sequence[float]],
    channels: Mapping[str, int] = CHANNELS,
    left_out: Sequence[str] = (),
    operation: str = "Conv",
) -> bytes:
    """Return a network whose outputs are the same everywhere, whatever the image.

    Args:
        values: of each kind of output, one number a channel.
        channels: of each kind.
        left_out: outputs that it has not.
        operation: of what makes the channels.
    """
    nodes, tensors, outputs = [], [_integers("shape", [1, -1, 0])], []
    for stride in STRIDES:
        pooled = f"pooled_{stride}"
        nodes.append(
            _node("MaxPool", ["input"], pooled, {"kernel_shape": [stride] * 2, "strides": [stride] * 2})
        )
        for kind, count in channels.items():
            name = f"{kind}_{stride}"
            if name in left_out:
                continue
            tensors.append(_floats(f"w_{name}", np.zeros((count, 3, 1, 1))))
            tensors.append(_floats(f"b_{name}", np.resize(np.array(values[kind], float), count)))
            made = [f"made_{name}", f"turned_{name}"]
            nodes.append(
                _node(operation, [pooled, f"w_{name}", f"b_{name}"], made[0], {"kernel_shape": [1, 1]})
            )
            nodes.append(_node("Transpose", made[:1], made[1], {"perm": [0, 2, 3, 1]}))
            tensors.append(_integers(f"shape_{name}", [1, -1, count]))
            nodes.append(_node("Reshape", [made[1], f"shape_{name}"], name, {}))
            outputs.append(_value(name, []))
    graph = b"".join(_bytes(1, node) for node in nodes) + _text(2, "g")
    graph += b"".join(_bytes(5, tensor) for tensor in tensors)
    graph += _bytes(11, _value("input", [1, 3, 320, 320])) + b"".join(_bytes(12, one) for one in outputs)
    return _number(1, 7) + _bytes(7, graph) + _bytes(8, _number(2, 11))


def _varint(value: int) -> bytes:
    value %= 1 << 64
    out = bytearray()
    while value >= 128:
        out.append(value % 128 | 128)
        value //= 128
    return bytes([*out, value])


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _bytes(field: int, data: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(data)) + data


def _text(field: int, text: str) -> bytes:
    return _bytes(field, text.encode())


def _node(
    operation: str, inputs: Sequence[str], output: str, attributes: Mapping[str, Sequence[int]]
) -> bytes:
    """NodeProto; attributes are lists of integers, type 7."""
    data = b"".join(_text(1, name) for name in inputs) + _text(2, output)
    data += _text(3, output) + (_text(4, operation) if operation else b"")
    for name, numbers in attributes.items():
        data += _bytes(5, _text(1, name) + b"".join(_number(8, one) for one in numbers) + _number(20, 7))
    return data


def _floats(name: str, values: np.ndarray) -> bytes:
    """TensorProto of single precision."""
    head = b"".join(_number(1, size) for size in values.shape) + _number(2, 1) + _text(8, name)
    return head + _bytes(9, values.astype("<f4").tobytes())


def _integers(name: str, values: Sequence[int]) -> bytes:
    """TensorProto of 64 bits."""
    data = np.array(values, "<i8").tobytes()
    return _number(1, len(values)) + _number(2, 7) + _text(8, name) + _bytes(9, data)


def _value(name: str, shape: Sequence[int]) -> bytes:
    """ValueInfoProto of single precision."""
    sizes = b"".join(_bytes(1, _number(1, size)) for size in shape)
    return _text(1, name) + _bytes(2, _bytes(1, _number(1, 1) + _bytes(2, sizes)))
