"""Vector instructions for kernels, written down where the compiler would not find them by itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from llvmlite import binding, ir
from numba import types
from numba.core import cgutils

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

FLOAT: Final = ir.FloatType()
INT32: Final = ir.IntType(32)
PLACE: Final = ir.IntType(64)
"""Of elements of arrays."""
LANES: Final = 16 if binding.get_host_cpu_features().get("avx512f") else 8
"""Numbers of float32 in a vector where many of them are kept at once: longer ones would not stay in registers."""
_CONTRACT: Final = ("contract",)
"""Allows that a product and a sum are rounded once."""
_LINE: Final = 16
"""Numbers of float32 in a cache line of 64 bytes."""


class Vectors:
    """Builds instructions on vectors of some length; machines without such vectors use several shorter ones.

    Parameters
    ----------
    builder : llvmlite.ir.IRBuilder
        Of the kernel that is compiled.
    length : int
        Numbers in a vector.
    """

    def __init__(self, builder: Any, length: int) -> None:
        self._builder, self.length = builder, length

    def of(self, kind: Any) -> Any:
        """Return the type of vectors of some numbers.

        Parameters
        ----------
        kind : llvmlite.ir.Type
            Of a number.
        """
        return ir.VectorType(kind, self.length)

    def ramp(self) -> Any:
        """Return 0, 1, 2, ... as float32."""
        return ir.Constant(self.of(FLOAT), [float(k) for k in range(self.length)])

    def spread(self, value: Any) -> Any:
        """Return a vector of one computed number, again and again.

        Parameters
        ----------
        value : llvmlite.ir.Value
            The number, of any type.
        """
        one = self._builder.insert_element(ir.Constant(self.of(value.type), ir.Undefined), value, INT32(0))
        return self.chosen(one, one, [0] * self.length)

    def chosen(self, first: Any, second: Any, places: Iterable[int]) -> Any:
        """Return numbers of two vectors.

        Parameters
        ----------
        first, second : llvmlite.ir.Value
            The vectors, of one type.
        places : iterable of int
            Places of the numbers, counted through both vectors.
        """
        return self._builder.shuffle_vector(first, second, ir.Constant(self.of(INT32), list(places)))

    def fused(self, a: Any, b: Any, c: Any) -> Any:
        """Return a b + c, rounded once where the processor can.

        Parameters
        ----------
        a, b, c : llvmlite.ir.Value
            Vectors of float32.
        """
        return self._builder.fadd(self._builder.fmul(a, b, flags=_CONTRACT), c, flags=_CONTRACT)

    def weighted(self, values: Sequence[Any], weights: Sequence[Any]) -> Any:
        """Return the weighted sum of vectors.

        Parameters
        ----------
        values, weights : sequence of llvmlite.ir.Value
            Vectors of float32.
        """
        total = self._builder.fmul(values[0], weights[0])
        for value, weight in zip(values[1:], weights[1:], strict=True):
            total = self.fused(value, weight, total)
        return total

    def load(self, data: Any, element: Any, count: Any = None) -> Any:
        """Return consecutive numbers of an array.

        Parameters
        ----------
        data : llvmlite.ir.Value
            Pointer to them.
        element : llvmlite.ir.Value
            Index of the first one.
        count : llvmlite.ir.Value, optional
            Number of those that are read, of float32, or less than 0: the others are 0. By default the whole vector.
        """
        place, kind = self._builder.gep(data, [element]), self.of(data.type.pointee)
        if count is None:
            return self._builder.load(self._builder.bitcast(place, kind.as_pointer()), align=4)
        read = self._first(count)
        takes = ir.FunctionType(kind, [kind.as_pointer(), INT32, read.type, kind])
        function = cgutils.get_or_insert_function(self._builder.module, takes, f"llvm.masked.load.v{self.length}f32.p0")
        zero = ir.Constant(kind, [0.0] * self.length)
        return self._builder.call(function, [self._builder.bitcast(place, kind.as_pointer()), INT32(4), read, zero])

    def _first(self, count: Any) -> Any:
        """Return which numbers are the first so many."""
        lane = ir.Constant(self.of(PLACE), list(range(self.length)))
        return self._builder.icmp_signed("<", lane, self.spread(count))

    def totals(self, values: Sequence[Any]) -> list[Any]:
        """Return vectors of the sums of the numbers of some vectors, one after the other.

        Parameters
        ----------
        values : sequence of llvmlite.ir.Value
            Vectors of float32, all of whose sums are found together.
        """
        zero, step = ir.Constant(self.of(FLOAT), [0.0] * self.length), 1
        sums = [*values, *[zero] * (-len(values) % self.length)]
        while step < self.length:
            # of two vectors each number is added to the one `step` beside it, by turns of the one and the other
            lower = [k // (2 * step) * 2 * step + k % step + k // step % 2 * self.length for k in range(self.length)]
            upper = [k + step for k in lower]
            pairs = zip(sums[::2], sums[1::2], strict=True)
            sums = [self._builder.fadd(self.chosen(*pair, lower), self.chosen(*pair, upper)) for pair in pairs]
            step *= 2
        return sums

    def store(self, vector: Any, data: Any, element: Any, count: Any = None) -> None:
        """Store a vector as consecutive numbers of an array.

        Parameters
        ----------
        vector : llvmlite.ir.Value
            The vector.
        data : llvmlite.ir.Value
            Pointer to its kind of numbers.
        element : llvmlite.ir.Value
            Index of the first one.
        count : llvmlite.ir.Value, optional
            Number of those that are stored, of float32, or less than 0 for none. By default the whole vector.
        """
        place = self._builder.bitcast(self._builder.gep(data, [element]), vector.type.as_pointer())
        if count is None:
            self._builder.store(vector, place, align=4)
            return
        stored = self._first(count)
        takes = ir.FunctionType(ir.VoidType(), [vector.type, place.type, INT32, stored.type])
        name = f"llvm.masked.store.v{self.length}f32.p0"
        function = cgutils.get_or_insert_function(self._builder.module, takes, name)
        self._builder.call(function, [vector, place, INT32(4), stored])


def are_images(*kinds: Any) -> bool:
    """Return True if all types, `kinds`, are of C-contiguous arrays of float32, whose numbers vectors consist of."""
    return all(kind.layout == "C" and kind.dtype == types.float32 for kind in kinds)


def data_of(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    """Return the pointer to the first element of an array that an intrinsic is given.

    Parameters
    ----------
    context, builder : object
        As numba gives them.
    kind : numba.types.Array
        Type of the array.
    array : llvmlite.ir.Value
        The array.
    """
    return context.make_array(kind)(context, builder, array).data


def aligned_zeros(count: int) -> NDArray[np.float32]:
    """Return `count` zeros at a multiple of 64 bytes, the length of a cache line."""
    zeros = np.zeros(count + _LINE, np.float32)
    first = -(zeros.ctypes.data // zeros.itemsize) % _LINE
    return zeros[first : first + count]
