"""The inner steps of the z-buffer on eight samples at a time, as vector instructions.

Samples lie in memory as blocks of eight neighbours in a row: their rays' x and y, their 1/z and their nearest face, four
vectors of 32 bits, so that a triangle that touches a block touches two cache lines. `index` finds a sample in the flat array.

Written as LLVM vectors because a compiler may not vectorise such loops by itself: it cannot know that reads and writes do not
overlap. Eight float32 lanes exist or are split on every processor, each product and sum is fused by definition, and nothing is
reordered, so results do not depend on the processor.
"""

# ruff: noqa: ARG001 - numba reads the names of an intrinsic's arguments; their values arrive in `args`

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

LANES = 8
BLOCK = 4 * LANES  # 32-bit words: x, y, 1/z, face
X, Y, INVERSE_Z, FACE = 0, LANES, 2 * LANES, 3 * LANES  # offsets in a block
_LONG = ir.IntType(64)
_FLOATS = ir.VectorType(ir.FloatType(), LANES)
_INTS = ir.VectorType(ir.IntType(32), LANES)
_FMA = ir.FunctionType(_FLOATS, [_FLOATS] * 3)


@njit(cache=True, nogil=True, inline="always")
def index(row: int, column: int, row_blocks: int) -> int:
    """Where the x of a sample lies in the flat array; add Y, INVERSE_Z or FACE for the rest."""
    return (row * row_blocks + column // LANES) * BLOCK + column % LANES


def _vector_at(builder: Any, base: Any, block: Any, offset: int, vector: Any) -> Any:
    word = builder.add(builder.mul(block, ir.Constant(_LONG, BLOCK)), ir.Constant(_LONG, offset))
    return builder.bitcast(builder.gep(base, [word]), vector.as_pointer())


def _splat(builder: Any, value: Any, vector: Any) -> Any:
    undefined = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(undefined, value, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, undefined, ir.Constant(_INTS, [0] * LANES))


def _data(context: Any, builder: Any, array_type: Any, value: Any) -> Any:
    return context.make_array(array_type)(context, builder, value=value).data


@intrinsic
def clear(typing_context: Any, samples: Any, blocks: Any) -> Any:
    """Forget what the first `blocks` blocks have seen: 1/z 0 and face -1; infinite 1/z where the ray is NaN and never hits."""
    signature = types.void(samples, types.int64)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        base = _data(context, builder, signature.args[0], args[0])
        zero, infinite = (ir.Constant(_FLOATS, [v] * LANES) for v in (0.0, float("inf")))
        with cgutils.for_range(builder, args[1]) as loop:
            x = builder.load(_vector_at(builder, base, loop.index, X, _FLOATS), align=4)
            seen = builder.select(builder.fcmp_ordered("ord", x, x), zero, infinite)
            builder.store(seen, _vector_at(builder, base, loop.index, INVERSE_Z, _FLOATS), align=4)
            nobody = ir.Constant(_INTS, [-1] * LANES)
            builder.store(nobody, _vector_at(builder, base, loop.index, FACE, _INTS), align=4)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def cover(
    typing_context: Any, samples: Any, start: Any, stride: Any, rows: Any, blocks: Any, edges: Any, plane: Any, limit: Any,
    face: Any,
) -> Any:  # fmt: skip
    """Note 1/z and `face` at the samples of the blocks start + stride * i + j where the triangle is hit and nearest.

    i < rows, j < blocks · edges: nine float32, for each edge the (a, b, c) of a x + b y + c, not negative inside · plane:
    three float32, the same for 1/z · limit: float32, the greatest 1/z that is seen · face: int32, the lower one wins at equal
    1/z. A NaN ray hits nothing.
    """
    long = types.int64
    signature = types.void(samples, long, long, long, long, edges, plane, limit, face)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        base = _data(context, builder, signature.args[0], args[0])
        fma = cgutils.get_or_insert_function(builder.module, _FMA, "llvm.fma.v8f32")
        zero = ir.Constant(_FLOATS, [0.0] * LANES)
        edge = [_splat(builder, builder.extract_value(args[5], k), _FLOATS) for k in range(9)]
        depth_plane = [_splat(builder, builder.extract_value(args[6], k), _FLOATS) for k in range(3)]
        farthest, number = _splat(builder, args[7], _FLOATS), _splat(builder, args[8], _INTS)
        with cgutils.for_range(builder, args[3]) as row:
            first = builder.add(args[1], builder.mul(row.index, args[2]))
            with cgutils.for_range(builder, args[4]) as column:
                block = builder.add(first, column.index)
                x = builder.load(_vector_at(builder, base, block, X, _FLOATS), align=4)
                y = builder.load(_vector_at(builder, base, block, Y, _FLOATS), align=4)
                w_at = _vector_at(builder, base, block, INVERSE_Z, _FLOATS)
                face_at = _vector_at(builder, base, block, FACE, _INTS)
                w, nearest = builder.load(w_at, align=4), builder.load(face_at, align=4)

                def linear(a: Any, b: Any, c: Any, x: Any = x, y: Any = y) -> Any:
                    return builder.call(fma, [a, x, builder.call(fma, [b, y, c])])

                depth = linear(*depth_plane)
                tie = builder.and_(builder.fcmp_ordered("==", depth, w), builder.icmp_signed("<", number, nearest))
                mask = builder.or_(builder.fcmp_ordered(">", depth, w), tie)
                mask = builder.and_(mask, builder.fcmp_ordered("<=", depth, farthest))
                least = linear(*edge[:3])
                for k in (3, 6):
                    other = linear(*edge[k : k + 3])
                    least = builder.select(builder.fcmp_ordered("<", other, least), other, least)
                mask = builder.and_(mask, builder.fcmp_ordered(">=", least, zero))
                # The least value, which changes nothing, keeps the compiler from making a masked store of selection and store:
                # some processors take a dozen cycles for one.
                for new, old, at, floor in ((depth, w, w_at, 0), (number, nearest, face_at, -1)):
                    bits = builder.bitcast(builder.select(mask, new, old), _INTS)
                    low = ir.Constant(_INTS, [floor] * LANES)
                    bits = builder.select(builder.icmp_signed(">", bits, low), bits, low)
                    builder.store(bits, builder.bitcast(at, _INTS.as_pointer()), align=4)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def lanes_that_see(typing_context: Any, samples: Any, block: Any) -> Any:
    """The lanes of a block that have a face, as bits."""
    signature = types.int64(samples, types.int64)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        base = _data(context, builder, signature.args[0], args[0])
        nearest = builder.load(_vector_at(builder, base, args[1], FACE, _INTS), align=4)
        mask = builder.icmp_signed(">=", nearest, ir.Constant(_INTS, [0] * LANES))
        return builder.zext(builder.bitcast(mask, ir.IntType(LANES)), _LONG)

    return signature, generate


@intrinsic
def first_lane(typing_context: Any, lanes: Any) -> Any:
    """Number of the lowest bit set; there is one."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), generate


@intrinsic
def incidence(
    typing_context: Any, samples: Any, block: Any, face: Any, matrices: Any, slot: Any, squared: Any, cosine: Any, at: Any
) -> Any:
    """|n|^2 |r|^2 and |n . r| of the samples of a block that see `face`, of interpolated normals n and rays r.

    matrices: (n, 9) float32, of which row `slot`, as a row-major 3x3 matrix, takes (x, y, 1) to n · squared, cosine: float32,
    set at `at` and the lanes after it where the sample sees the face; not negative. Returns these lanes as bits.
    """
    long = types.int64
    signature = long(samples, long, types.int32, matrices, long, squared, cosine, long)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        base, table, squares, cosines = (_data(context, builder, signature.args[k], args[k]) for k in (0, 3, 5, 6))
        x = builder.load(_vector_at(builder, base, args[1], X, _FLOATS), align=4)
        y = builder.load(_vector_at(builder, base, args[1], Y, _FLOATS), align=4)
        nearest = builder.load(_vector_at(builder, base, args[1], FACE, _INTS), align=4)
        mask = builder.icmp_signed("==", nearest, _splat(builder, args[2], _INTS))
        first = builder.mul(args[4], ir.Constant(_LONG, 9))
        m = [
            _splat(builder, builder.load(builder.gep(table, [builder.add(first, ir.Constant(_LONG, k))])), _FLOATS)
            for k in range(9)
        ]
        n = [builder.fadd(builder.fadd(builder.fmul(m[k], x), builder.fmul(m[k + 1], y)), m[k + 2]) for k in (0, 3, 6)]

        def dot(a: Any, b: Any, c: Any) -> Any:
            return builder.fadd(builder.fadd(a, b), c)

        one = ir.Constant(_FLOATS, [1.0] * LANES)
        normal = dot(*(builder.fmul(value, value) for value in n))
        ray = dot(builder.fmul(x, x), builder.fmul(y, y), one)
        both = dot(builder.fmul(n[0], x), builder.fmul(n[1], y), n[2])
        positive = ir.Constant(_INTS, [0x7FFF_FFFF] * LANES)
        for array, value in ((squares, builder.fmul(normal, ray)), (cosines, both)):
            bits = builder.and_(builder.bitcast(value, _INTS), positive)
            place = builder.bitcast(builder.gep(array, [args[7]]), _INTS.as_pointer())
            bits = builder.select(mask, bits, builder.load(place, align=4))
            low = ir.Constant(_INTS, [0] * LANES)  # no masked store, as in `cover`
            builder.store(builder.select(builder.icmp_signed(">", bits, low), bits, low), place, align=4)
        return builder.zext(builder.bitcast(mask, ir.IntType(LANES)), _LONG)

    return signature, generate
