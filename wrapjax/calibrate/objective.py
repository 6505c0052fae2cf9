"""What a calibration minimises, and its derivatives by blocks of muscles."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.calibrate.penalties import AbstractPenalty
from wrapjax.calibrate.problem import AbstractLeastSquares, Linearization
from wrapjax.model import ModelParameters, Recording, Variables, muscle_state, muscle_states
from wrapjax.muscle import HillCurves

#: Allowable error of a joint moment in N m (the NMSM Pipeline's default).
MOMENT_ERROR = 2.5


class Objective(AbstractLeastSquares):
    """Moment error, penalties and priors as one least-squares problem.

    The cost is the plain sum of its terms, each a mean square in allowable errors.
    """

    curves: HillCurves
    recording: Recording
    measured: Float[Array, "trial coordinate frame"]
    variables: Variables
    penalties: tuple[AbstractPenalty, ...]
    #: Allowable error of a moment, N m. Lowering it weakens every penalty against the moments.
    moment_error: Float[Array | np.ndarray, ""] = eqx.field(default_factory=lambda: np.array(MOMENT_ERROR))

    @property
    def lower(self) -> Float[Array | np.ndarray, " variable"]:
        """Lower bounds of the scaled variables."""
        return self.variables.lower

    @property
    def upper(self) -> Float[Array | np.ndarray, " variable"]:
        """Upper bounds of the scaled variables."""
        return self.variables.upper

    def terms(self, parameters: ModelParameters) -> dict[str, Float[Array, " row"]]:
        """Residuals by term; the cost of a term is the sum of squares of its residuals."""
        states = muscle_states(self.curves, parameters, self.recording)
        residuals = {"joint_moment": self._moment_rows(states.moment.sum(axis=0))}
        for penalty in self.penalties:
            residuals[penalty.name] = penalty.rows(jax.vmap(penalty.read)(parameters, states)).ravel()
        residuals["prior"] = self._prior_rows(self.variables.pack(parameters))
        return residuals

    def cost(self, parameters: ModelParameters) -> Float[Array, ""]:
        """Sum of squares of all residuals: a pure function, to be differentiated as one likes."""
        return sum((jnp.sum(rows**2) for rows in self.terms(parameters).values()), start=jnp.zeros(()))

    def residuals(self, variables: Float[Array, " variable"]) -> Float[Array, " row"]:
        """All residuals as one vector, for solvers that want nothing else."""
        return jnp.concatenate(list(self.terms(self.variables.unpack(variables)).values()))

    def linearize(self, variables: Float[Array, " variable"]) -> Linearization:
        """Compute cost, gradient and both parts of the Hessian by blocks of muscles.

        A muscle's parameters touch its own force alone. So one small forward-mode Jacobian a muscle
        gives all first derivatives, and the second derivatives of all residuals, weighted by the
        residuals, are one small block a muscle. Only the joint moments add up over muscles.
        """
        shape = self.variables.index.shape
        moment, values, moment_slopes, value_slopes = self._muscle_blocks(variables)
        rows = self._moment_rows(moment.sum(axis=0))
        transposed = self.variables.gather(moment_slopes)
        cost = jnp.sum(rows**2)
        gradient = transposed @ rows
        local_gradient = jnp.zeros(shape)
        local_gram = jnp.zeros(shape + shape)
        multipliers = []
        for penalty, value, slope in zip(self.penalties, values, value_slopes, strict=True):
            penalty_rows, pull_back = jax.vjp(penalty.rows, value)
            multipliers.append(pull_back(penalty_rows)[0])
            cost += jnp.sum(penalty_rows**2)
            local_gradient += jnp.einsum("mk,mpk->mp", multipliers[-1], slope)
            local_gram += penalty.gram(slope)
        gradient += self.variables.gather(local_gradient[..., None])[:, 0]
        prior_rows = self._prior_rows(variables)
        prior_slope = self._prior_weight()
        return Linearization(
            cost=cost + jnp.sum(prior_rows**2),
            gradient=gradient + prior_slope * prior_rows,
            gauss_newton=transposed @ transposed.T + self._gather(local_gram) + jnp.diag(prior_slope**2),
            remainder=self._gather(self._second_order(variables, rows, tuple(multipliers))),
        )

    def moment_jacobian(self, variables: Float[Array, " variable"]) -> Float[Array, "row variable"]:
        """Differentiate the moment residuals, muscle by muscle."""
        _, _, moment_slopes, _ = self._muscle_blocks(variables)
        return self.variables.gather(moment_slopes).T

    def _muscle_outputs(self, local, scale, parameters, recording):
        """What the residuals are made of, for one muscle."""
        parameters = self.variables.insert(parameters, local, scale)
        state = muscle_state(self.curves, parameters, recording)
        return state.moment, tuple(penalty.read(parameters, state) for penalty in self.penalties)

    def _muscle_inputs(self, variables: Float[Array, " variable"]):
        local = self.variables.localize(variables)
        return local, jnp.asarray(self.variables.scale), self.variables.base, self.recording

    def _muscle_blocks(self, variables: Float[Array, " variable"]):
        """Values and derivatives by local variables, of every muscle."""

        def blocks(local, *inputs):
            def along(direction):
                return jax.jvp(lambda at: self._muscle_outputs(at, *inputs), (local,), (direction,))

            # By hand and not by `jax.jacfwd`, whose last axis counts the directions: with it first,
            # gathering the Jacobian copies whole rows, and that is a third of all the time.
            return jax.vmap(along, out_axes=(None, 0))(jnp.eye(local.size))

        (moment, values), slopes = jax.vmap(blocks)(*self._muscle_inputs(variables))
        muscles, directions = slopes[0].shape[:2]
        moment_slopes = self._moment_scale() * slopes[0].reshape(muscles, directions, -1)
        return moment, values, moment_slopes, slopes[1]

    def _second_order(
        self,
        variables: Float[Array, " variable"],
        rows: Float[Array, " row"],
        multipliers: tuple[Float[Array, "muscle _"], ...],
    ) -> Float[Array, "muscle local muscle local"]:
        """Sum of residuals times their Hessians: one block a muscle, for moments add linearly."""

        def weighted(local, multiplier, *inputs):
            moment, values = self._muscle_outputs(local, *inputs)
            total = self._moment_scale() * rows @ moment.ravel()
            return sum((one @ value for one, value in zip(multiplier, values, strict=True)), start=total)

        local, *inputs = self._muscle_inputs(variables)
        blocks = jax.vmap(jax.hessian(weighted))(local, multipliers, *inputs)
        each = np.arange(local.shape[0])
        return jnp.zeros(local.shape + local.shape).at[each, :, each, :].set(blocks)

    def _gather(self, local: Float[Array, "muscle local muscle local"]) -> Float[Array, "variable variable"]:
        shape = self.variables.index.shape
        half = self.variables.gather(local.reshape(*shape, -1))
        return self.variables.gather(half.T.reshape(*shape, -1))

    def _moment_scale(self) -> Float[Array, ""]:
        return 1.0 / (jnp.asarray(self.moment_error) * np.sqrt(self.measured.size))

    def _moment_rows(self, modelled: Float[Array, "trial coordinate frame"]) -> Float[Array, " row"]:
        return self._moment_scale() * (modelled - self.measured).ravel()

    def _prior_weight(self) -> Float[Array | np.ndarray, " variable"]:
        """One over prior deviation and the root of how many variables of its kind there are."""
        kinds = [label.rsplit(".", 1)[1] for label in self.variables.labels]
        counts = np.array([kinds.count(kind) for kind in kinds])
        return self.variables.prior_precision / np.sqrt(counts)

    def _prior_rows(self, variables: Float[Array, " variable"]) -> Float[Array, " variable"]:
        return jnp.asarray(self._prior_weight()) * (variables - self.variables.prior_mean)
