"""Objective of a calibration, and its first and second derivatives assembled from blocks of muscles."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.calibration.linearized_limits import muscle_limits
from wrapjax.calibration.muscle_derivatives import (
    Outputs,
    coupled_hessian,
    coupled_jacobian,
    framewise_hessian,
    framewise_jacobian,
    path_jacobian,
    scalar_jacobian,
    second_derivatives,
)
from wrapjax.calibration.penalties import AbstractPenalty, Limit
from wrapjax.calibration.solvers.interface import AbstractCalibration, Linearization
from wrapjax.geometry.paths import PathState
from wrapjax.model.alteration import (
    Alteration,
    altered_emg,
    altered_moments,
    altered_paths,
    muscle_alterations,
)
from wrapjax.model.forward import MuscleState, Recording, muscle_state_along, muscle_states
from wrapjax.model.parameters import ModelParameters
from wrapjax.model.variables import Batch, LocalBlocks, Variables, of_batch
from wrapjax.muscle.curves import AbstractCurves

#: Allowable error of a joint moment, N m (the default of the NMSM Pipeline).
MOMENT_ERROR = 2.5
#: Number of rows below which a symmetric product is not divided.
_UNDIVIDED_ROWS = 300


class Objective(AbstractCalibration):
    """Least-squares objective: joint moment errors, penalties and priors.

    The cost is the sum of its terms. Each term is a mean square of residuals divided by their allowable error
    (of moments and penalties) or prior standard deviation.
    """

    curves: AbstractCurves
    #: EMG and paths of the calibration cycles.
    recording: Recording
    #: Measured joint moments, N m.
    measured: Float[Array, "trial coordinate frame"]
    variables: Variables
    penalties: tuple[AbstractPenalty, ...]
    #: Hard limits, with the shifts and weights of the augmented Lagrangian method.
    limits: tuple[Limit, ...]
    #: Allowable error of a moment, N m; infinite for moments that are not matched. A smaller error gives the
    #: moments more weight relative to the penalties.
    moment_error: Float[Array | np.ndarray, ""] | Float[Array | np.ndarray, "#trial #coordinate #frame"] = (
        eqx.field(default_factory=lambda: np.array(MOMENT_ERROR))
    )
    #: Changes of the plain model, which are not calibrated; with those of paths, all paths must be held.
    alterations: tuple[Alteration, ...] = ()
    #: Variables of the muscles that cross each coordinate, by which alone its moment can change; empty where
    #: this is not known.
    crossing_variables: tuple[tuple[int, ...], ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        # An altered path may depend on the paths of several muscles, whose modes then affect other forces.
        if self.variables.modes and any(alteration.paths is not None for alteration in self.alterations):
            raise ValueError("a model whose paths are altered can be calibrated with held paths only")

    @property
    def lower(self) -> Float[Array | np.ndarray, " variable"]:
        """Lower bounds of the scaled variables."""
        return self.variables.lower

    @property
    def upper(self) -> Float[Array | np.ndarray, " variable"]:
        """Upper bounds of the scaled variables."""
        return self.variables.upper

    @property
    def resolution(self) -> float:
        """Relative decrease of the cost below which its expansion fails because of kinks of the paths."""
        return self.recording.path.resolution

    def with_limits(self, limits: tuple[Limit, ...]) -> Objective:
        """Return the objective with other limits."""
        return replace(self, limits=limits)

    @property
    def initial(self) -> ModelParameters:
        """Parameter tree before calibration."""
        return self.variables.base

    def parameters(self, variables: Float[Array, " variable"]) -> ModelParameters:
        """Insert variables into the parameter tree."""
        return self.variables.unpack(variables)

    def start(self, parameters: ModelParameters) -> Float[Array, " variable"]:
        """Extract the variables from a parameter tree and clip them to the bounds."""
        return jnp.clip(self.variables.pack(parameters), self.lower, self.upper)

    def terms(self, parameters: ModelParameters) -> dict[str, Float[Array, " row"]]:
        """Compute the residuals by term; the cost of a term is the sum of squares of its residuals.

        The terms are ``joint_moment``, those of the penalties by name, and ``prior``. Limits are not terms.
        """
        states = self._states(parameters)
        residuals = {"joint_moment": self._moment_rows(states.moment.sum(axis=0))}
        for penalty in self.penalties:
            residuals[penalty.name] = penalty.rows(penalty.values(parameters, states)).ravel()
        residuals["prior"] = self._prior_rows(self.variables.pack(parameters))
        return residuals

    def cost(self, parameters: ModelParameters) -> Float[Array, ""]:
        """Compute the sum of squares of all terms, a pure function of the parameter tree."""
        return sum((jnp.sum(rows**2) for rows in self.terms(parameters).values()), start=jnp.zeros(()))

    def excess(self, variables: Float[Array, " variable"]) -> tuple[Float[Array, "muscle _"], ...]:
        """Compute the excess of each limited value over its bound, by limit; negative below the bound."""
        parameters = self.variables.unpack(variables)
        states = self._states(parameters)
        return tuple(limit.excess(limit.values(parameters, states)) for limit in self.limits)

    def residuals(self, variables: Float[Array, " variable"]) -> Float[Array, " row"]:
        """Compute all residuals, those of limits included, as one vector."""
        parameters = self.variables.unpack(variables)
        states = self._states(parameters)
        limited = [limit.rows(limit.values(parameters, states)).ravel() for limit in self.limits]
        return jnp.concatenate([*self.terms(parameters).values(), *limited])

    def value(self, variables: Float[Array, " variable"]) -> Float[Array, ""]:
        """Compute the sum of squares of all residuals, those of limits included."""
        return jnp.sum(self.residuals(variables) ** 2)

    def linearize(self, variables: Float[Array, " variable"]) -> Linearization:
        """Compute cost, gradient, and the Gauss-Newton part and remainder of the Hessian; see `expand`."""
        return self.expand(variables)[0]

    def expand(
        self, variables: Float[Array, " variable"]
    ) -> tuple[Linearization, Float[Array, "row variable"]]:
        """Compute the second-order expansion of the cost and the Jacobian of the moment residuals.

        A muscle's parameters affect its own force alone. One small Jacobian per muscle therefore gives all
        first derivatives, and the second derivatives of the residuals, weighted by the residuals, are one
        small block per muscle. Only the joint moments are sums over muscles.

        Returns
        -------
        expansion, jacobian
            See `linearize` and `moment_jacobian`.
        """
        inputs = self._muscle_inputs(variables)
        moment, values, moment_slopes, value_slopes = self._muscle_slopes(inputs)
        rows = self._moment_rows(moment.sum(axis=0))
        transposed = self.variables.gather(moment_slopes)
        prior_rows, prior_slope = self._prior_rows(variables), jnp.asarray(self._prior_weight())
        cost = jnp.sum(rows**2) + jnp.sum(prior_rows**2)
        gradient = transposed @ rows + prior_slope * prior_rows
        gauss_newton = self._moment_gram(transposed) + jnp.diag(prior_slope**2)
        local_gradient = moment_slopes.map(lambda own: jnp.zeros((*own.shape[:2], 1)))
        own_gram = moment_slopes.map(lambda own: jnp.zeros((*own.shape[:2], own.shape[1])))
        groups: dict[tuple[int, ...], Array] = {}
        multipliers = []
        for penalty, value, slope in zip(self._all_penalties, values, value_slopes, strict=True):
            penalty_rows, pull_back = jax.vjp(penalty.rows, value)
            multipliers.append(pull_back(penalty_rows)[0])
            cost += jnp.sum(penalty_rows**2)
            local_gradient += slope.map(_weighted_sum, multipliers[-1])
            gram = penalty.gram_matrix(value, slope)
            if gram.own is not None:
                own_gram += gram.own
            for members, block in gram.groups:
                groups[members] = groups[members] + block if members in groups else block
        first_limit = len(self.penalties)
        limits = muscle_limits(self.limits, values[first_limit:], value_slopes[first_limit:], self.variables)
        curvatures = self._muscle_curvatures(inputs, rows, tuple(multipliers))
        if self.variables.modes:
            curvatures += self._path_curvatures(variables, inputs, rows, tuple(multipliers))
        model = Linearization(
            cost=cost,
            gradient=gradient + self.variables.gather(local_gradient)[:, 0],
            gauss_newton=gauss_newton + self.variables.assemble(own_gram, groups),
            remainder=self.variables.assemble(curvatures),
            limits=limits,
        )
        return model, transposed.T

    def moment_jacobian(self, variables: Float[Array, " variable"]) -> Float[Array, "row variable"]:
        """Compute the Jacobian of the moment residuals by the variables."""
        _, _, moment_slopes, _ = self._muscle_slopes(self._muscle_inputs(variables))
        return self.variables.gather(moment_slopes).T

    def _states(self, parameters: ModelParameters) -> MuscleState:
        return muscle_states(self.curves, parameters, self.recording, self.alterations)

    @property
    def _all_penalties(self) -> tuple[AbstractPenalty, ...]:
        """Penalties and limits."""
        return (*self.penalties, *self.limits)

    def _moment_gram(self, transposed: Float[Array, "variable row"]) -> Float[Array, "variable variable"]:
        """Compute ``J'J`` of the moment residuals from the transposed Jacobian.

        A muscle crosses one to four of the coordinates. Products by coordinate need a third of the operations
        where every muscle has many variables.
        """
        if not self.crossing_variables:
            return transposed @ transposed.T
        by_coordinate = transposed.reshape(len(transposed), *self.measured.shape)
        total = jnp.zeros((len(transposed), len(transposed)))
        for crossing in filter(None, dict.fromkeys(self.crossing_variables)):
            coordinates = [place for place, own in enumerate(self.crossing_variables) if own == crossing]
            chosen = np.array(crossing)
            own = by_coordinate[chosen][:, :, np.array(coordinates)].reshape(len(chosen), -1)
            total = total.at[chosen[:, None], chosen].add(symmetric_product(own))
        return total

    def _muscle_inputs(self, variables: Float[Array, " variable"]):
        """Collect the arguments of the functions of one muscle, with a leading axis ``muscle``."""
        count, modes = self.variables.nonpath_count, self.variables.modes
        scale = jnp.asarray(self.variables.scale)
        changes = self.variables.unpack(variables).path_changes
        path, by_change = self.recording.path.linearized(changes)
        by_change = jax.tree.map(lambda leaf: leaf[:, :modes], by_change)
        single = self.variables.localize(variables)[:, :count]
        path = altered_paths(path, self.alterations)
        emg, parts = altered_emg(self.recording.emg, self.alterations), muscle_alterations(self.alterations)
        return single, path, by_change, scale, self.variables.base, emg, parts

    def _unit_modes(self, inputs: tuple, batch: Batch) -> PathState:
        """Compute the change of the paths of a batch per solver unit of each mode that it has."""
        count = self.variables.nonpath_count
        _, _, by_change, scale, *_ = of_batch(batch, inputs)
        unit = scale[:, count : batch.entries]
        return jax.tree.map(
            lambda leaf: jnp.einsum("mk,mk...->mk...", unit, leaf[:, : batch.entries - count]), by_change
        )

    def _muscle_outputs(self, single, path, scale, base, emg, parts):
        """Compute the moment of one muscle and the quantities of its penalties and limits."""
        parameters = self.variables.insert(base, single * scale)
        recording = self.recording
        state = muscle_state_along(
            path, self.curves, parameters, emg, recording.padding, parts, recording.frames
        )
        return state.moment, tuple(penalty.read(parameters, state) for penalty in self._all_penalties)

    def _muscle_slopes(self, inputs: tuple):
        """Compute outputs and their derivatives by local variables, of every muscle."""
        by_modes = bool(self.variables.modes)
        reductions = [penalty.reduce for penalty in self._all_penalties]

        def reduced(outputs: tuple) -> tuple[Array, tuple[Array, ...]]:
            moment, quantities = outputs
            return moment, tuple(map(lambda reduce, one: reduce(one), reductions, quantities))

        def of_one(single, path, modes, *inputs):
            outputs = self._outputs_of(*inputs)
            values, by_single = scalar_jacobian(outputs, single, path)
            if not by_modes:
                return reduced(values), by_single, None
            along = (
                coupled_jacobian(outputs, single, path, modes)
                if self.alterations
                else path_jacobian(outputs, single, path)
            )
            return reduced(values), by_single, along

        def by_local(by_single, along, modes):
            slopes = by_single
            if by_modes:
                along = (
                    jax.tree.map(lambda leaf: leaf[: len(modes.length)], along)
                    if self.alterations
                    else framewise_jacobian(along, modes)
                )
                slopes = jax.tree.map(lambda *both: jnp.concatenate(both), by_single, along)
            moment_slope, value_slopes = jax.vmap(reduced)(slopes)
            flat = moment_slope.reshape(moment_slope.shape[0], -1)
            return self.row_scale()[None] * flat, value_slopes

        single, path, _, scale, *others = inputs
        count, batches = self.variables.nonpath_count, self.variables.batches
        modes = self._unit_modes(inputs, self.variables.all_muscles)
        (moment, values), by_single, along = jax.vmap(of_one)(single, path, modes, scale[:, :count], *others)
        parts = [
            jax.vmap(by_local)(
                of_batch(batch, by_single), of_batch(batch, along), self._unit_modes(inputs, batch)
            )
            for batch in batches
        ]
        moment_slopes, value_slopes = jax.tree.map(lambda *own: LocalBlocks(batches, own), *parts)
        return moment, values, moment_slopes, value_slopes

    def _outputs_of(self, *inputs) -> Outputs:
        """Return the outputs of one muscle as a function of its scalar parameters and its path."""
        return lambda single, path: self._muscle_outputs(single, path, *inputs)

    def _muscle_curvatures(
        self,
        inputs: tuple,
        rows: Float[Array, " row"],
        multipliers: tuple[Float[Array, "muscle _"], ...],
    ) -> LocalBlocks:
        """Compute the sum of residuals times their Hessians: one block per muscle, as moments are sums.

        Moments are linear in the moment arms. Arms are therefore first summed over coordinates, weighted by
        the residuals of the moments; quantities of the arms alone have no second derivatives. Second
        derivatives by the muscle law are omitted, as in a Gauss-Newton method: they cost more than they gain.
        """
        weights = (self.row_scale() * rows).reshape(self.measured.shape)

        def with_weighted_arm(path: PathState) -> PathState:
            # Not `jnp.einsum`, which copies the arms of all modes to another order of axes.
            own = jnp.broadcast_to(weights, path.moment_arm.shape)
            return replace(path, moment_arm=jnp.sum(own * path.moment_arm, axis=-2, keepdims=True))

        laws = self.variables.laws
        count = self.variables.nonpath_count - laws
        by_modes = bool(self.variables.modes)

        def of_one(own, single, path, modes, *inputs):
            law = single[count:]

            def weighted_sum(single, path):
                moment, quantities = self._muscle_outputs(jnp.concatenate([single, law]), path, *inputs)
                total = jnp.sum(moment)
                for multiplier, penalty, quantity in zip(own, self._all_penalties, quantities, strict=True):
                    if quantity.ndim < 3:
                        total += multiplier @ penalty.reduce(quantity)
                return total

            single, path = single[:count], with_weighted_arm(path)
            if not by_modes:
                return jax.hessian(weighted_sum)(single, path)
            if self.alterations:
                return coupled_hessian(weighted_sum, single, path, with_weighted_arm(modes))
            return second_derivatives(weighted_sum, single, path)

        def by_local(second, modes):
            if by_modes and not self.alterations:
                return framewise_hessian(second, with_weighted_arm(modes))
            kept = count + len(modes.length)
            return second[:kept, :kept]

        single, path, _, scale, *others = inputs
        modes = self._unit_modes(inputs, self.variables.all_muscles)
        scale = scale[:, : self.variables.nonpath_count]
        second = jax.vmap(of_one)(multipliers, single, path, modes, scale, *others)

        def of_muscles(batch: Batch) -> Float[Array, "muscle local local"]:
            blocks = jax.vmap(by_local)(of_batch(batch, second), self._unit_modes(inputs, batch))
            if not laws:
                return blocks
            kept = np.delete(np.arange(batch.entries), np.s_[count : count + laws])
            full = jnp.zeros((len(blocks), batch.entries, batch.entries))
            return full.at[:, kept[:, None], kept[None]].set(blocks)

        batches = self.variables.batches
        return LocalBlocks(batches, tuple(map(of_muscles, batches)))

    def _path_curvatures(
        self,
        variables: Float[Array, " variable"],
        inputs: tuple,
        rows: Float[Array, " row"],
        multipliers: tuple[Float[Array, "muscle _"], ...],
    ) -> LocalBlocks:
        """Compute the part of that sum due to second derivatives of the path by its modes."""
        weights = (self.row_scale() * rows).reshape(self.measured.shape)
        count = self.variables.nonpath_count

        def of_one(own, single, path, modes, *inputs):
            def weighted_sum(path):
                moment, quantities = self._muscle_outputs(single, path, *inputs)
                total = jnp.vdot(weights, moment)
                for multiplier, penalty, quantity in zip(own, self._all_penalties, quantities, strict=True):
                    total += multiplier @ penalty.reduce(quantity)
                return total

            return jax.grad(weighted_sum)(path)

        changes = self.variables.unpack(variables).path_changes
        single, path, by_change, scale, *others = inputs
        by_path = jax.vmap(of_one)(multipliers, single, path, None, scale[:, :count], *others)
        curvature = self.recording.path.curvature(changes, by_path, (path, by_change))
        unit = scale[:, count:]
        modes = unit.shape[1]
        block = unit[:, :, None] * curvature[:, :modes, :modes] * unit[:, None, :]
        full = jnp.zeros((*scale.shape, scale.shape[1])).at[:, count:, count:].set(block)
        batches = self.variables.batches
        parts = [of_batch(batch, full)[:, : batch.entries, : batch.entries] for batch in batches]
        return LocalBlocks(batches, tuple(parts))

    def row_scale(self) -> Float[Array, " row"]:
        """Compute the factor that turns a moment in N m into a residual, for each residual."""
        error = jnp.broadcast_to(jnp.asarray(self.moment_error), self.measured.shape)
        return (1.0 / (error * np.sqrt(self.measured.size))).ravel()

    def _moment_rows(self, modelled: Float[Array, "trial coordinate frame"]) -> Float[Array, " row"]:
        modelled = altered_moments(modelled, self.alterations)
        return self.row_scale() * (modelled - self.measured).ravel()

    def _prior_weight(self) -> Float[Array | np.ndarray, " variable"]:
        """Compute one over the prior deviation and the root of the number of variables of the same kind."""
        kinds = [label.rsplit(".", 1)[1] for label in self.variables.labels]
        counts = np.array([kinds.count(kind) for kind in kinds])
        return self.variables.prior_precision / np.sqrt(counts)

    def _prior_rows(self, variables: Float[Array, " variable"]) -> Float[Array, " variable"]:
        return jnp.asarray(self._prior_weight()) * (variables - self.variables.prior_mean)


def _weighted_sum(
    slopes: Float[Array, "muscle local value"], multiplier: Float[Array, "muscle value"]
) -> Float[Array, "muscle local 1"]:
    """Sum the derivatives of each muscle's values, weighted by multipliers."""
    return jnp.einsum("mk,mpk->mp", multiplier, slopes)[..., None]


def symmetric_product(matrix: Float[Array, "row column"]) -> Float[Array, "row row"]:
    """Multiply a large matrix by its transpose, with a third fewer operations than usual.

    The product is symmetric, so that the lower of its blocks are copies.
    """
    if len(matrix) < _UNDIVIDED_ROWS:
        return matrix @ matrix.T
    first, second = jnp.array_split(matrix, 2)
    across = first @ second.T
    return jnp.block([[symmetric_product(first), across], [across.T, symmetric_product(second)]])
