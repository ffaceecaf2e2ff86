"""Eight values at a time, and those that count put side by side: what compilers do not find.

A loop that keeps some of what it meets, ``out[size] = value; size += keep``, is a step per value
for a compiler. Processors do eight at once: compare, push those that count together, store all
eight, and go on behind the ones that counted. Here are values of eight numbers (*lanes*) for
compiled kernels, and the few operations on them that these need:

============================== ===========================================================
``load, store``                eight values of an array from an index on
``spread, ascending``          a number in every lane; a number and the seven after it
``+ - * /``, ``root``          of floats, each rounded as the single operation is
``absolute``                   of floats
``where``                      ``a if mask else b`` by lane
``greater, lesser``            ``a > b ? a : b`` and ``a < b ? a : b`` by lane
``greatest, least``            the same over all lanes
``middles``                    the two in the middle of a number of values, by lane
``< <= > >= == !=``            a mask; False wherever a NaN takes part, but for ``!=``
``& |``, ``number``            of masks, ``&`` of bits too; how many lanes a mask holds
``pack``                       store the lanes of a mask side by side
============================== ===========================================================

An array must have room for :data:`LANES` values from each index that is named: what lies behind
the values of interest is read, and overwritten. Arrays are C-contiguous, and indices are unsigned.

Packing is LLVM's ``vector.compress`` within a register, a single instruction, with AVX-512; its
twin that stores only what counts is slow on some processors. Without AVX-512 lanes are stored one
by one, as the loop does.
"""

import operator
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

LANES: Final = 8
"""Values at a time [count]."""

TOGETHER: Final = 128
"""What is gathered before vectors work on it, as it lies apart in memory; speed only [count]."""

UL: Final = np.uint64(LANES)
"""The same, to count indices on."""

_BITS, _INDEX = ir.IntType(LANES), ir.IntType(64)
_OF: Final = {
    types.float64: ir.DoubleType(),
    types.uint64: _INDEX,
    types.boolean: ir.IntType(1),
}


class Lanes(types.Type):
    """Type of eight values in a compiled kernel."""

    def __init__(self, kind: Any) -> None:
        self.kind = kind
        super().__init__(name=f"lanes({kind})")


FLOATS, WHOLES, MASK = Lanes(types.float64), Lanes(types.uint64), Lanes(types.boolean)
_HELD: Final = {
    types.int32: FLOATS, types.float64: FLOATS, types.uint64: WHOLES, types.boolean: MASK,
}  # fmt: skip


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    """A vector register."""

    def __init__(self, manager: Any, lanes: Lanes) -> None:
        super().__init__(manager, lanes, _vector(_OF[lanes.kind]))  # type: ignore[no-untyped-call]


def _intrinsic(function: Callable[..., Any]) -> Any:
    """What numba makes of a function that writes instructions; kernels call it with values."""
    return intrinsic(function)


def _vector(kind: ir.Type) -> ir.VectorType:
    return ir.VectorType(kind, LANES)


def _everywhere(builder: ir.IRBuilder, value: ir.Value) -> ir.Value:
    nothing = ir.Constant(_vector(value.type), ir.Undefined)
    first = builder.insert_element(nothing, value, ir.IntType(32)(0))
    every = ir.Constant(_vector(ir.IntType(32)), [0] * LANES)
    return builder.shuffle_vector(first, nothing, every)


def _address(
    context: Any, builder: ir.IRBuilder, kind: Any, array: ir.Value, at: ir.Value
) -> tuple[ir.Value, int]:
    """Where eight values of an array from an index on lie, and how they are aligned [B]."""
    held = context.make_array(kind)(context, builder, value=array)
    index = cgutils.unpack_tuple(builder, at) if kind.ndim > 1 else [at]  # type: ignore[no-untyped-call]
    first = cgutils.get_item_pointer(context, builder, kind, held, index, wraparound=False)  # type: ignore[no-untyped-call]
    bytes_each = context.get_abi_sizeof(first.type.pointee)
    return builder.bitcast(first, _vector(first.type.pointee).as_pointer()), bytes_each


def _is_address(array: Any, at: Any) -> bool:
    """Whether these are an array whose values lie side by side, and an unsigned index of it."""
    index = tuple(at) if isinstance(at, types.UniTuple) else (at,)
    return (
        isinstance(array, types.Array)
        and array.layout == "C"
        and array.dtype in _HELD
        and len(index) == array.ndim
        and all(i == types.uint64 for i in index)
    )


@_intrinsic
def load(_: Any, array: Any, at: Any) -> Any:
    """Eight values of an array from an index on; of int32 as floats, of bool as a mask."""
    if not _is_address(array, at):
        return None

    def codegen(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        address, align = _address(context, builder, sig.args[0], *args)
        values = builder.load(address, align=align)
        if sig.args[0].dtype == types.int32:
            values = builder.sitofp(values, _vector(_OF[types.float64]))
        elif sig.args[0].dtype == types.boolean:
            values = builder.icmp_unsigned("!=", values, ir.Constant(values.type, None))
        return values

    return _HELD[array.dtype](array, at), codegen


@_intrinsic
def store(_: Any, array: Any, at: Any, values: Any) -> Any:
    """Write eight values to an array of their kind from an index on."""
    if not _is_address(array, at) or Lanes(array.dtype) != values or values == MASK:
        return None

    def codegen(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        address, align = _address(context, builder, sig.args[0], *args[:2])
        builder.store(args[2], address, align=align)
        return context.get_dummy_value()

    return types.void(array, at, values), codegen


def _compresses(context: Any) -> bool:
    """Whether the processor that is compiled for packs the lanes of a register."""
    return "+avx512f" in context.codegen().magic_tuple()[2]


def _store_one_by_one(
    builder: ir.IRBuilder, values: ir.Value, mask: ir.Value, address: ir.Value
) -> None:
    """Store each lane where the next one goes, and go on behind it if it counts."""
    first = builder.bitcast(address, values.type.element.as_pointer())
    bits = builder.zext(builder.bitcast(mask, _BITS), _INDEX)
    at = _INDEX(0)
    for lane in range(LANES):
        value = builder.extract_element(values, ir.IntType(32)(lane))
        builder.store(value, builder.gep(first, [at]))
        held = builder.and_(builder.lshr(bits, _INDEX(lane)), _INDEX(1))
        at = builder.add(at, held)


@_intrinsic
def pack(_: Any, array: Any, at: Any, values: Any, mask: Any) -> Any:
    """Write the values of the lanes in a mask side by side from an index on, then anything."""
    if not _is_address(array, at) or Lanes(array.dtype) != values or mask != MASK:
        return None

    def codegen(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        array, at, values, mask = args
        address, align = _address(context, builder, sig.args[0], array, at)
        if _compresses(context):
            name = f"llvm.experimental.vector.compress.v{LANES}{values.type.element.intrinsic_name}"
            kind = ir.FunctionType(values.type, [values.type, mask.type, values.type])
            compress = builder.module.declare_intrinsic(name, (), kind)
            nothing = ir.Constant(values.type, ir.Undefined)
            builder.store(builder.call(compress, [values, mask, nothing]), address, align=align)
        else:
            _store_one_by_one(builder, values, mask, address)
        return context.get_dummy_value()

    return types.void(array, at, values, mask), codegen


@_intrinsic
def spread(_: Any, value: Any) -> Any:
    """A float or an unsigned number in every lane."""
    if value not in {types.float64, types.uint64}:
        return None

    def codegen(_: Any, builder: ir.IRBuilder, __: Any, args: Any) -> ir.Value:
        return _everywhere(builder, args[0])

    return Lanes(value)(value), codegen


@_intrinsic
def ascending(_: Any, first: Any) -> Any:
    """An unsigned number and the seven after it."""
    if first != types.uint64:
        return None

    def codegen(_: Any, builder: ir.IRBuilder, __: Any, args: Any) -> ir.Value:
        steps = ir.Constant(_vector(_INDEX), list(range(LANES)))
        return builder.add(_everywhere(builder, args[0]), steps)

    return WHOLES(first), codegen


@_intrinsic
def number(_: Any, mask: Any) -> Any:
    """How many lanes a mask holds, uint64."""
    if mask != MASK:
        return None

    def codegen(_: Any, builder: ir.IRBuilder, __: Any, args: Any) -> ir.Value:
        return builder.zext(builder.ctpop(builder.bitcast(args[0], _BITS)), _INDEX)

    return types.uint64(mask), codegen


def _each(name: str) -> Any:
    """What LLVM calls so, of each lane."""

    def apply(_: Any, values: Any) -> Any:
        if values != FLOATS:
            return None

        def codegen(_: Any, builder: ir.IRBuilder, __: Any, args: Any) -> ir.Value:
            kind = ir.FunctionType(args[0].type, [args[0].type])
            called = builder.module.declare_intrinsic(f"llvm.{name}.v{LANES}f64", (), kind)
            return builder.call(called, args)

        return FLOATS(values), codegen

    return apply


root, absolute = _intrinsic(_each("sqrt")), _intrinsic(_each("fabs"))


@_intrinsic
def where(_: Any, mask: Any, a: Any, b: Any) -> Any:
    """The first of two values in the lanes of a mask, the second in the others."""
    if mask != MASK or a != b or not isinstance(a, Lanes):
        return None

    def codegen(_: Any, builder: ir.IRBuilder, __: Any, args: Any) -> ir.Value:
        return builder.select(*args)

    return a(mask, a, b), codegen


def _compare(builder: ir.IRBuilder, kind: Lanes, sign: str, a: ir.Value, b: ir.Value) -> ir.Value:
    compare = builder.fcmp_ordered if kind == FLOATS else builder.icmp_unsigned
    return compare(sign, a, b)


def middles(pairs: Sequence[tuple[int, int]], size: int) -> Any:
    """What gives the two values in the middle of some, by lane, without storing any.

    Parameters
    ----------
    pairs : sequence of (int, int)
        Comparisons, in order: where the lesser and where the greater value goes.

    Returns
    -------
    callable
        Of an array and an index, from which on ``size`` times eight values lie.
    """

    def middle(_: Any, array: Any, at: Any) -> Any:
        if not _is_address(array, at) or array.dtype != types.float64:
            return None

        def codegen(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
            address, align = _address(context, builder, sig.args[0], *args)
            values = [
                builder.load(builder.gep(address, [_INDEX(k)]), align=align) for k in range(size)
            ]
            for i, j in pairs:
                one, other = values[i], values[j]
                less, more = (builder.fcmp_ordered(s, one, other) for s in "<>")
                values[i] = builder.select(less, one, other)
                values[j] = builder.select(more, one, other)
            found = values[size // 2 - 1 : size // 2 + 1]
            return context.make_tuple(builder, sig.return_type, found)

        pair = types.UniTuple(FLOATS, 2)  # type: ignore[no-untyped-call]
        return pair(array, at), codegen

    return _intrinsic(middle)


def _chosen(sign: str) -> Any:
    """One of two values by lane: the first where the comparison with the second holds."""

    def choose(_: Any, a: Any, b: Any) -> Any:
        if a != b or a not in {FLOATS, WHOLES}:
            return None

        def codegen(_: Any, builder: ir.IRBuilder, __: Any, args: Any) -> ir.Value:
            return builder.select(_compare(builder, a, sign, *args), *args)

        return a(a, b), codegen

    return choose


def _of_all(sign: str) -> Any:
    """One of the eight lanes: of halves the chosen ones, and so on."""

    def reduce(_: Any, values: Any) -> Any:
        if values not in {FLOATS, WHOLES}:
            return None

        def codegen(_: Any, builder: ir.IRBuilder, __: Any, args: Any) -> ir.Value:
            left = args[0]
            for size in (4, 2, 1):
                halves = [
                    builder.shuffle_vector(
                        left,
                        ir.Constant(left.type, ir.Undefined),
                        ir.Constant(
                            ir.VectorType(ir.IntType(32), size), list(range(at, at + size))
                        ),
                    )
                    for at in (0, size)
                ]
                left = builder.select(_compare(builder, values, sign, *halves), *halves)
            return builder.extract_element(left, ir.IntType(32)(0))

        return values.kind(values), codegen

    return reduce


greater, lesser = _intrinsic(_chosen(">")), _intrinsic(_chosen("<"))
greatest, least = _intrinsic(_of_all(">")), _intrinsic(_of_all("<"))


def _operate(
    function: Callable[[Any, Any], Any],
    kinds: dict[Lanes, Callable[[ir.IRBuilder, ir.Value, ir.Value], ir.Value]],
    result: Lanes | None = None,
) -> None:
    """Give an operator its meaning for lanes of some kinds; a result is of the same by default."""

    class Typing(AbstractTemplate):
        key = function

        def generic(self, args: Any, kws: Any) -> Any:
            if not kws and len(args) == 2 and args[0] == args[1] and args[0] in kinds:
                return signature(result or args[0], *args)  # type: ignore[no-untyped-call]
            return None

    def lower(_: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        return kinds[sig.args[0]](builder, *args)

    infer_global(function)(Typing)  # type: ignore[no-untyped-call]
    lower_builtin(function, Lanes, Lanes)(lower)  # type: ignore[no-untyped-call]


def _compared(sign: str) -> dict[Lanes, Callable[[ir.IRBuilder, ir.Value, ir.Value], ir.Value]]:
    def floats(builder: ir.IRBuilder, a: ir.Value, b: ir.Value) -> ir.Value:
        compare = builder.fcmp_unordered if sign == "!=" else builder.fcmp_ordered
        return compare(sign, a, b)

    def wholes(builder: ir.IRBuilder, a: ir.Value, b: ir.Value) -> ir.Value:
        return builder.icmp_unsigned(sign, a, b)

    return {FLOATS: floats, WHOLES: wholes}


_operate(operator.add, {FLOATS: ir.IRBuilder.fadd})
_operate(operator.sub, {FLOATS: ir.IRBuilder.fsub})
_operate(operator.mul, {FLOATS: ir.IRBuilder.fmul})
_operate(operator.truediv, {FLOATS: ir.IRBuilder.fdiv})
_operate(operator.and_, {MASK: ir.IRBuilder.and_, WHOLES: ir.IRBuilder.and_})
_operate(operator.or_, {MASK: ir.IRBuilder.or_})
for _function, _sign in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.eq, "=="),
    (operator.ne, "!="),
):
    _operate(_function, _compared(_sign), MASK)
