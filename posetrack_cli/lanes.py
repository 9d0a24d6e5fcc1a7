"""Operations on several numbers at once, for kernels.

LLVM vectorises long loops over arrays, but not short rows of pixels, nor loops that append to lists.
Functions made with ``emitted`` compute such blocks with vector instructions of a fixed number of lanes,
which LLVM splits where registers are shorter. Each lane is computed like a single number, so results do not
depend on the CPU.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any, cast

import numpy as np

BLOCK = 16
"""Lanes of a block of float32."""
_LINE = 64
"""Bytes of a cache line; vectors that lie in two take twice as long."""
_BYTES = {"float": 4, "i32": 4, "double": 8, "i64": 8}


class Lanes:
    """An LLVM value while a kernel is compiled: a number, an array's first element, or a vector of numbers.

    Operators emit instructions. A number meets a vector as one value in all lanes.

    Args:
        builder: of the kernel.
        value: of LLVM.
    """

    def __init__(self, builder: Any, value: Any) -> None:
        self.builder, self.value = builder, value

    def __add__(self, other: Lanes | float) -> Lanes:
        return self._with(other, "fadd", "add")

    def __sub__(self, other: Lanes | float) -> Lanes:
        return self._with(other, "fsub", "sub")

    def __mul__(self, other: Lanes | float) -> Lanes:
        return self._with(other, "fmul", "mul")

    def __rsub__(self, other: float) -> Lanes:
        return self.constant(other) - self

    def __rtruediv__(self, other: float) -> Lanes:
        return self.constant(other)._with(self, "fdiv", "sdiv")

    def __and__(self, other: Lanes) -> Lanes:
        return self._with(other, "and_", "and_")

    def __lt__(self, other: Lanes | float) -> Lanes:
        return self._compared("<", other)

    def __le__(self, other: Lanes | float) -> Lanes:
        return self._compared("<=", other)

    def __gt__(self, other: Lanes | float) -> Lanes:
        return self._compared(">", other)

    def __ge__(self, other: Lanes | float) -> Lanes:
        return self._compared(">=", other)

    def least(self, other: Lanes) -> Lanes:
        """Return the smaller numbers."""
        return self.where(self < other, other)

    def where(self, chosen: Lanes, other: Lanes | float) -> Lanes:
        """Return these numbers in the lanes that are chosen, and others elsewhere."""
        return Lanes(self.builder, self.builder.select(chosen.value, self.value, self._like(other).value))

    def converted(self, kind: str) -> Lanes:
        """Return integers or floats of 32 or 64 bits as "float", "double" or "i64"."""
        ir, b, old = _ir(), self.builder, self._element()
        new: Any = {"float": ir.FloatType(), "double": ir.DoubleType(), "i64": ir.IntType(64)}[kind]
        if old == new:
            return self
        if isinstance(old, ir.IntType):
            cast = b.sext if kind == "i64" else b.sitofp
        else:
            cast = b.fpext if kind == "double" else b.fptrunc
        count = self._count()
        return Lanes(b, cast(self.value, ir.VectorType(new, count) if count else new))

    def counted(self, count: int) -> Lanes:
        """Return a number n as n, n + 1, n + 2, ..."""
        splat, element = self._splat(count), self._element()
        steps = _ir().Constant(splat.value.type, [_ir().Constant(element, k) for k in range(count)])
        return splat + Lanes(self.builder, steps)

    def number(self, index: int) -> Lanes:
        """Return one element of an array."""
        place = self.builder.gep(self.value, [_ir().Constant(_ir().IntType(64), index)])
        return Lanes(self.builder, self.builder.load(place))

    def load(self, at: Lanes, count: int) -> Lanes:
        """Return the elements of an array from an index on; memory must reach so far."""
        ir, place = _ir(), self._at(at)
        vector = ir.VectorType(place.type.pointee, count)
        first = self.builder.bitcast(place, vector.as_pointer())
        return Lanes(self.builder, self.builder.load(first, align=_BYTES[str(vector.element)]))

    def store(self, at: Lanes, values: Lanes) -> None:
        """Write elements of an array from an index on."""
        place = self.builder.bitcast(self._at(at), values.value.type.as_pointer())
        self.builder.store(values.value, place, align=_BYTES[str(values._element())])

    def append(self, at: Lanes, values: Lanes, chosen: Lanes) -> None:
        """Write the chosen numbers one after the other from an index on."""
        ir, place, vector = _ir(), self._at(at), values.value.type
        code = {"float": "f32", "i32": "i32"}[str(vector.element)]
        function = _cgutils().get_or_insert_function(
            self.builder.module,
            ir.FunctionType(ir.VoidType(), [vector, place.type, chosen.value.type]),
            f"llvm.masked.compressstore.v{vector.count}{code}",
        )
        self.builder.call(function, [values.value, place, chosen.value])

    @property
    def bits(self) -> Lanes:
        """Truth of each lane as a bit of an integer."""
        packed = self.builder.bitcast(self.value, _ir().IntType(self._count()))
        return Lanes(self.builder, self.builder.zext(packed, _ir().IntType(64)))

    def unpacked(self, count: int) -> Lanes:
        """Return the lanes whose ``bits`` a number has."""
        ir = _ir()
        packed = self.builder.trunc(self.value, ir.IntType(count))
        return Lanes(self.builder, self.builder.bitcast(packed, ir.VectorType(ir.IntType(1), count)))

    def constant(self, number: float) -> Lanes:
        """Return a constant of the same type."""
        ir, element, count = _ir(), self._element(), self._count()
        value = ir.Constant(element, int(number) if isinstance(element, ir.IntType) else float(number))
        return Lanes(self.builder, ir.Constant(self.value.type, [value] * count) if count else value)

    def _count(self) -> int:
        kind = self.value.type
        return int(kind.count) if isinstance(kind, _ir().VectorType) else 0

    def _element(self) -> Any:
        return self.value.type.element if self._count() else self.value.type

    def _at(self, at: Lanes) -> Any:
        return self.builder.gep(self.value, [at.value])

    def _splat(self, count: int) -> Lanes:
        ir, b = _ir(), self.builder
        empty = ir.Constant(ir.VectorType(self.value.type, count), ir.Undefined)
        first = b.insert_element(empty, self.value, ir.Constant(ir.IntType(32), 0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), count), [ir.Constant(ir.IntType(32), 0)] * count)
        return Lanes(b, b.shuffle_vector(first, empty, zeros))

    def _like(self, other: Lanes | float) -> Lanes:
        if not isinstance(other, Lanes):
            return self.constant(other)
        return other._splat(self._count()) if self._count() and not other._count() else other

    def _with(self, other: Lanes | float, floats: str, integers: str) -> Lanes:
        a, b = self, self._like(other)
        if b._count() and not a._count():
            a = a._splat(b._count())
        name = integers if isinstance(a._element(), _ir().IntType) else floats
        return Lanes(self.builder, getattr(self.builder, name)(a.value, b.value))

    def _compared(self, sign: str, other: Lanes | float) -> Lanes:
        compare = (
            self.builder.icmp_signed
            if isinstance(self._element(), _ir().IntType)
            else self.builder.fcmp_ordered
        )
        return Lanes(self.builder, compare(sign, self.value, self._like(other).value))


def emitted(
    function: Callable[..., Lanes | None],
) -> Callable[..., Any]:
    """Make a function of ``Lanes`` callable from kernels, with numbers and arrays; it is inlined there.

    It returns an integer, or nothing. Arrays are contiguous, and indices count all their elements.
    """
    return cast("Callable[..., Any]", _Emitted(function))


class _Emitted:
    """An instruction sequence that loads numba when a kernel with it is compiled."""

    def __init__(self, function: Callable[..., Lanes | None]) -> None:
        functools.update_wrapper(cast("Callable[..., Any]", self), function)
        self._function = function

    @functools.cached_property
    def _numba_type_(self) -> Any:
        """Type by which numba finds the function in kernels."""
        import numba.core.types
        import numba.core.typing.templates

        types: Any = numba.core.types  # untyped library
        templates: Any = numba.core.typing.templates
        function, names = self._function, list(inspect.signature(self._function).parameters)
        gives = inspect.signature(self._function).return_annotation != "None"

        def typed(context: Any, *kinds: Any) -> Any:
            def build(context: Any, builder: Any, signature: Any, values: Any) -> Any:
                pairs = zip(signature.args, values, strict=True)
                plain = [
                    _cgutils().create_struct_proxy(kind)(context, builder, value=value).data
                    if isinstance(kind, types.Array)
                    else value
                    for kind, value in pairs
                ]
                result = function(*(Lanes(builder, value) for value in plain))
                return context.get_dummy_value() if result is None else result.value

            return (types.int64 if gives else types.void)(*map(types.unliteral, kinds)), build

        parameters = [inspect.Parameter(n, inspect.Parameter.POSITIONAL_ONLY) for n in ["context", *names]]
        typed.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        return types.Function(templates.make_intrinsic_template(self, typed, self._function.__name__))


@functools.cache
def _cgutils() -> Any:
    from numba.core import cgutils

    return cgutils


def _ir() -> Any:
    """Return the module with LLVM's types."""
    return _cgutils().ir


# Blocks of 16 numbers of an array from an index on. The first ``count`` matter; memory reaches further.


@emitted
def above(values: Lanes, at: Lanes, count: Lanes, bound: Lanes) -> Lanes:
    """Return bits of the values above a bound."""
    return ((values.load(at, BLOCK) > bound) & _within(count)).bits


@emitted
def below(values: Lanes, at: Lanes, count: Lanes, bound: Lanes) -> Lanes:
    """Return bits of the values below a bound."""
    return ((values.load(at, BLOCK) < bound) & _within(count)).bits


@emitted
def append(chosen: Lanes, values: Lanes, at: Lanes, out: Lanes, to: Lanes) -> None:
    """Write the values whose bits are set one after the other to ``out[to:]``."""
    out.append(to, values.load(at, BLOCK), chosen.unpacked(BLOCK))


@emitted
def append_indices(chosen: Lanes, first: Lanes, out: Lanes, to: Lanes) -> None:
    """Write ``first`` plus the place of each set bit one after the other to ``out[to:]``."""
    number = Lanes(first.builder, first.builder.trunc(first.value, _ir().IntType(32)))
    out.append(to, number.counted(BLOCK), chosen.unpacked(BLOCK))


@emitted
def bit_count(bits: Lanes) -> Lanes:
    """Return the number of bits that are set."""
    return Lanes(bits.builder, bits.builder.ctpop(bits.value))


@emitted
def add_block(values: Lanes, at: Lanes, count: Lanes, totals: Lanes) -> None:
    """Add float32 values to the totals (16,) of their lanes."""
    first = count.constant(0)
    more = values.load(at, BLOCK).where(_within(count), 0.0)
    totals.store(first, totals.load(first, BLOCK) + more.converted("double"))


@emitted
def multiply_block(values: Lanes, at: Lanes, count: Lanes, products: Lanes) -> None:
    """Multiply float32 values with the products (16,) of their lanes."""
    first = count.constant(0)
    more = values.load(at, BLOCK).where(_within(count), 1.0)
    products.store(first, products.load(first, BLOCK) * more.converted("double"))


def _within(count: Lanes) -> Lanes:
    """Return the lanes before ``count``."""
    return count.constant(0).counted(BLOCK) < count


def padded(values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return a copy whose memory reaches a block further, and begins where a cache line does."""
    size, spare = values.size, _LINE // values.itemsize
    memory = np.zeros(size + BLOCK + spare, values.dtype)
    first = -memory.ctypes.data % _LINE // values.itemsize
    copy = memory[first : first + size].reshape(values.shape)
    copy[...] = values
    return copy
