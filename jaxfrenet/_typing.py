"""Array types for annotations such as `Float[Array, "obstacles steps"]`.

They are jaxtyping's, which the tests check at every call. At run time nothing evaluates them, so the package works
without jaxtyping.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxtyping import Array, Bool, Float, Int
else:
    try:
        from jaxtyping import Array, Bool, Float, Int
    except ImportError:
        from typing import Any

        from jax import Array

        Bool = Float = Int = Any

__all__ = ["Array", "Bool", "Float", "Int"]
