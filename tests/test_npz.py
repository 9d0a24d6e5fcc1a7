"""npz files of strangers: what numpy writes is read as numpy reads it, whatever else is one line."""

from __future__ import annotations

import struct
import tracemalloc
import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posetrack_cli import limits
from posetrack_cli.npz import NpzError, read_npz

ARRAYS: dict[str, np.ndarray[Any, Any]] = {
    "doubles": np.arange(6.0).reshape(2, 3) / 7.0,
    "by columns": np.asfortranarray(np.arange(6.0, dtype=np.float32).reshape(2, 3)),
    "number": np.array(-3),
    "bytes": np.arange(256, dtype=np.uint8),
    "truths": np.array([True, False]),
    "text": np.array(["é", "longer"]),
    "none": np.zeros((0, 4)),
    "complex": np.array([1j]),
}


def npz(arrays: dict[str, np.ndarray[Any, Any]], *, compressed: bool = False) -> bytes:
    stream = BytesIO()
    (np.savez_compressed if compressed else np.savez)(stream, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()


def npy(descr: str, shape: str, data: bytes = b"", order: str = "False") -> bytes:
    """An array whose header is written by hand."""
    header = f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


def zipped(entries: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> bytes:
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w", compression) as archive:
        for name, data in entries.items():
            archive.writestr(name, data)
    return stream.getvalue()


def refused(data: bytes, match: str) -> None:
    with pytest.raises(NpzError, match=match) as error:
        read_npz(data)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("compressed", [False, True])
def test_arrays_come_back_as_numpy_reads_them(tmp_path: Path, compressed: bool) -> None:
    path = tmp_path / "arrays.npz"
    path.write_bytes(npz(ARRAYS, compressed=compressed))
    with path.open("rb") as stream:
        found = read_npz(stream)
    assert list(found) == list(ARRAYS)
    with np.load(path, allow_pickle=False) as expected:
        for name, array in found.items():
            np.testing.assert_array_equal(array, expected[name])
            assert array.dtype == expected[name].dtype
            assert array.flags.writeable and array.flags.f_contiguous == expected[name].flags.f_contiguous


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 0.999])
def test_a_part_of_a_file_is_refused(share: float) -> None:
    data = npz(ARRAYS)
    refused(data[: int(share * len(data))], "not a complete npz file")


def test_flipped_bytes_are_refused_or_change_nothing() -> None:
    data, rng = npz({"values": np.arange(40.0)}), np.random.default_rng(0)
    for _ in range(300):
        damaged = bytearray(data)
        damaged[rng.integers(len(data))] ^= int(rng.integers(1, 256))
        try:
            found = read_npz(bytes(damaged))
        except NpzError:
            continue
        for array in found.values():
            np.testing.assert_array_equal(array, np.arange(40.0))


def test_what_expands_far_is_refused_before_it_is_expanded() -> None:
    """3 MB of zeros compressed claim 3.2 GB; of them next to nothing is read."""
    size = 3_200_000_000
    header = npy("'<f8'", f"({(size - 128) // 8},)")
    data = bytearray(zipped({"zeros.npy": header + bytes(1 << 20)}, zipfile.ZIP_DEFLATED))
    index = data.rindex(b"PK\x01\x02")
    struct.pack_into("<I", data, index + 24, size)  # the size that the zip's index states
    tracemalloc.start()
    refused(bytes(data), f"arrays of {size} bytes in total exceed the limit of {limits.NPZ_FLOOR_BYTES}")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 20


def test_more_arrays_than_any_file_has_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "NPZ_ARRAYS", 7)
    refused(npz(ARRAYS), "8 arrays exceed the limit of 7")


@pytest.mark.parametrize(
    ("shape", "data"),
    [
        ("(1000000000000,)", b""),
        ("(3,)", bytes(16)),
        ("(1,)", bytes(16)),
        ("(999999999999999999, 999999999999999999)", bytes(8)),
        ("()", b""),
    ],
)
def test_a_header_of_other_sizes_than_the_file_has_is_refused(shape: str, data: bytes) -> None:
    refused(
        zipped({"values.npy": npy("'<f8'", shape, data)}),
        f"array 'values' has {len(data)} bytes, which do not fit",
    )


@pytest.mark.parametrize(
    "descr",
    [
        "'|O'",
        "'>f8'",
        "'<f16'",
        "'<f3'",
        "'<M8[ns]'",
        "'|V8'",
        "[('a', '<f8')]",
        "'<f8'" + "[" * 3000,
        "__import__('os').system('true')",
        "(" * 5000,
    ],
)
def test_types_that_are_not_plain_are_refused(descr: str) -> None:
    refused(zipped({"values.npy": npy(descr, "(1,)", bytes(8))}), "array 'values' has an unsupported type")


@pytest.mark.parametrize(
    ("shape", "match"),
    [("(-1,)", "type,"), ("(1,) * 9", "type,"), ("(" + "1, " * 9 + ")", "type or shape")],
)
def test_shapes_that_are_none_are_refused(shape: str, match: str) -> None:
    refused(
        zipped({"values.npy": npy("'<f8'", shape, bytes(8))}), f"array 'values' has an unsupported {match}"
    )


def test_objects_are_refused_and_nothing_is_run() -> None:
    with pytest.raises(NpzError, match="unsupported type, expected numbers"):
        read_npz(npz({"object": np.array([{"a": 1}], dtype=object)}))


def test_names_that_come_twice_are_refused() -> None:
    with pytest.warns(UserWarning, match="Duplicate name"):
        stream = BytesIO()
        with zipfile.ZipFile(stream, "w") as archive:
            for _ in range(2):
                archive.writestr("values.npy", npy("'<f8'", "(1,)", bytes(8)))
    refused(stream.getvalue(), "array 'values' occurs twice")


def test_what_is_encrypted_or_no_array_is_refused() -> None:
    data = bytearray(npz({"values": np.arange(3.0)}))
    data[data.rindex(b"PK\x01\x02") + 8] |= 1
    refused(bytes(data), "array 'values' is encrypted")
    refused(zipped({"readme.txt": b"text"}), r"'readme\.txt' is not an array")
    refused(zipped({"values.npy": b"text"}), "'values' is not an array")
    refused(
        zipped({"values.npy": npy("'<f8'", "(1,)", bytes(8))}, zipfile.ZIP_LZMA), "unsupported compression"
    )


def test_bytes_that_are_no_value_of_their_type_are_refused() -> None:
    refused(zipped({"truths.npy": npy("'|b1'", "(2,)", b"\x01\x02")}), "invalid booleans")
    refused(zipped({"text.npy": npy("'<U1'", "(1,)", b"\xff\xff\xff\xff")}), "invalid text")
