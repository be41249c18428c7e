"""The sampling matrix by hand."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrenet as jf
from jaxfrenet.sampling import sample_end_states


@pytest.mark.parametrize(
    ("level", "end_times"),
    [(0, [1.1, 2.1, 3.0]), (1, [1.1, 1.6, 2.1, 2.6, 3.0]), (2, [1.1, 1.4, 1.7, 2.0, 2.3, 2.6, 2.9, 3.0])],
)
def test_end_times(level, end_times):
    np.testing.assert_allclose(0.1 * jf.PlannerConfig(sampling_level=level).end_steps, end_times, atol=1e-9)


@pytest.mark.parametrize(
    ("speed", "lowest", "highest"), [(10.0, 0.001, 15.75), (40.0, 5.5, 36.0), (0.0, 0.001, 5.75), (34.0, 0.001, 36.0)]
)
def test_end_speeds(speed, lowest, highest):
    got = sample_end_states(jf.PlannerConfig(), jnp.float32(speed), jnp.float32(speed + 0.25), jnp.float32(0.5)).speed
    np.testing.assert_allclose(got[:-1], np.linspace(lowest, highest, 9), atol=1e-5)
    assert float(got[-1]) == speed + 0.25


def test_end_offsets():
    got = sample_end_states(jf.PlannerConfig(), jnp.float32(9.0), jnp.float32(9.0), jnp.float32(0.5)).offset
    np.testing.assert_allclose(got, [*np.linspace(-3.5, 3.5, 9), 0.5], atol=1e-6)
