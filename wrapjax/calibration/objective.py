"""What a calibration minimises, and its derivatives by blocks of muscles."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.calibration.muscle_derivatives import (
    curvature,
    curvature_through_time,
    slopes,
    slopes_through_time,
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
from wrapjax.model.variables import Variables
from wrapjax.muscle.curves import AbstractCurves

#: Allowable error of a joint moment in N m (the NMSM Pipeline's default).
MOMENT_ERROR = 2.5


class Objective(AbstractCalibration):
    """Moment error, penalties and priors as one least-squares problem.

    The cost is the plain sum of its terms, each a mean square in allowable errors.
    """

    curves: AbstractCurves
    recording: Recording
    measured: Float[Array, "trial coordinate frame"]
    variables: Variables
    penalties: tuple[AbstractPenalty, ...]
    limits: tuple[Limit, ...]
    #: Allowable error of a moment, N m; infinite where a moment does not count. Lowering it weakens every
    #: penalty against the moments.
    moment_error: Float[Array | np.ndarray, ""] | Float[Array | np.ndarray, "#trial #coordinate #frame"] = (
        eqx.field(default_factory=lambda: np.array(MOMENT_ERROR))
    )
    #: What else there is than the plain model, held at its amounts. What changes paths needs held ones.
    alterations: tuple[Alteration, ...] = ()

    def __check_init__(self):
        # An altered path may be a mix of several muscles' ones, and their modes then touch other forces.
        if self.variables.modes and any(one.paths is not None for one in self.alterations):
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
        """As fine as the paths are smooth."""
        return self.recording.path.resolution

    def with_limits(self, limits: tuple[Limit, ...]) -> Objective:
        """Take others in their place."""
        return replace(self, limits=limits)

    @property
    def initial(self) -> ModelParameters:
        """Parameter tree before calibration."""
        return self.variables.base

    def parameters(self, variables: Float[Array, " variable"]) -> ModelParameters:
        """Put variables into the parameter tree."""
        return self.variables.unpack(variables)

    def start(self, parameters: ModelParameters) -> Float[Array, " variable"]:
        """Read the variables off a tree and move them inside the bounds."""
        return jnp.clip(self.variables.pack(parameters), self.lower, self.upper)

    def terms(self, parameters: ModelParameters) -> dict[str, Float[Array, " row"]]:
        """Residuals by term; the cost of a term is the sum of squares of its residuals.

        Limits are no terms: they cost nothing where they are kept.
        """
        states = self._states(parameters)
        residuals = {"joint_moment": self._moment_rows(states.moment.sum(axis=0))}
        for penalty in self.penalties:
            residuals[penalty.name] = penalty.rows(penalty.values(parameters, states)).ravel()
        residuals["prior"] = self._prior_rows(self.variables.pack(parameters))
        return residuals

    def cost(self, parameters: ModelParameters) -> Float[Array, ""]:
        """Sum of squares of all terms: a pure function, to be differentiated as one likes."""
        return sum((jnp.sum(rows**2) for rows in self.terms(parameters).values()), start=jnp.zeros(()))

    def excess(self, variables: Float[Array, " variable"]) -> tuple[Float[Array, "muscle _"], ...]:
        """Give how far each limited value is above its bound, by limit; negative: below."""
        parameters = self.variables.unpack(variables)
        states = self._states(parameters)
        return tuple(limit.excess(limit.values(parameters, states)) for limit in self.limits)

    def residuals(self, variables: Float[Array, " variable"]) -> Float[Array, " row"]:
        """All residuals, those of limits too, as one vector for solvers that want nothing else."""
        parameters = self.variables.unpack(variables)
        states = self._states(parameters)
        limited = [limit.rows(limit.values(parameters, states)).ravel() for limit in self.limits]
        return jnp.concatenate([*self.terms(parameters).values(), *limited])

    def value(self, variables: Float[Array, " variable"]) -> Float[Array, ""]:
        """Sum of squares of all residuals, those of limits too."""
        return jnp.sum(self.residuals(variables) ** 2)

    def linearize(self, variables: Float[Array, " variable"]) -> Linearization:
        """Compute cost, gradient and both parts of the Hessian: see `expand`."""
        return self.expand(variables)[0]

    def expand(
        self, variables: Float[Array, " variable"]
    ) -> tuple[Linearization, Float[Array, "row variable"]]:
        """Compute what `linearize` does, and what `moment_jacobian` does, by blocks of muscles.

        A muscle's parameters touch its own force alone. So one small Jacobian a muscle gives all first
        derivatives, and the second derivatives of all residuals, weighted by the residuals, are one
        small block a muscle. Only the joint moments add up over muscles.
        """
        index = self.variables.index
        inputs = self._muscle_inputs(variables)
        moment, values, moment_slopes, value_slopes = self._muscle_slopes(inputs)
        rows = self._moment_rows(moment.sum(axis=0))
        transposed = self.variables.gather(moment_slopes)
        prior_rows, prior_slope = self._prior_rows(variables), jnp.asarray(self._prior_weight())
        cost = jnp.sum(rows**2) + jnp.sum(prior_rows**2)
        gradient = transposed @ rows + prior_slope * prior_rows
        gauss_newton = transposed @ transposed.T + jnp.diag(prior_slope**2)
        local_gradient = jnp.zeros(index.shape)
        own_gram = jnp.zeros((*index.shape, index.shape[1]))
        groups: dict[tuple[int, ...], Array] = {}
        multipliers = []
        for restraint, value, slope in zip(self._restraints, values, value_slopes, strict=True):
            restraint_rows, pull_back = jax.vjp(restraint.rows, value)
            multipliers.append(pull_back(restraint_rows)[0])
            cost += jnp.sum(restraint_rows**2)
            local_gradient += jnp.einsum("mk,mpk->mp", multipliers[-1], slope)
            gram = restraint.gram(value, slope)
            own_gram += gram.own
            for members, block in gram.groups:
                groups[members] = groups[members] + block if members in groups else block
        curvatures = self._muscle_curvatures(inputs, rows, tuple(multipliers))
        if self.variables.modes:
            curvatures += self._path_curvatures(variables, inputs, rows, tuple(multipliers))
        model = Linearization(
            cost=cost,
            gradient=gradient + self.variables.gather(local_gradient[..., None])[:, 0],
            gauss_newton=gauss_newton + self.variables.assemble(own_gram, groups),
            remainder=self.variables.assemble(curvatures),
        )
        return model, transposed.T

    def moment_jacobian(self, variables: Float[Array, " variable"]) -> Float[Array, "row variable"]:
        """Differentiate the moment residuals, muscle by muscle."""
        _, _, moment_slopes, _ = self._muscle_slopes(self._muscle_inputs(variables))
        return self.variables.gather(moment_slopes).T

    def _states(self, parameters: ModelParameters) -> MuscleState:
        return muscle_states(self.curves, parameters, self.recording, self.alterations)

    @property
    def _restraints(self) -> tuple[AbstractPenalty, ...]:
        return (*self.penalties, *self.limits)

    def _muscle_inputs(self, variables: Float[Array, " variable"]):
        """What the functions of one muscle take, with a leading axis ``muscle``."""
        count, modes = self.variables.nonpath_count, self.variables.modes
        scale = jnp.asarray(self.variables.scale)
        changes = self.variables.unpack(variables).path_changes
        path, by_change = self.recording.path.linearized(changes)
        unit_modes = jax.tree.map(
            lambda leaf: jnp.einsum("mk,mk...->mk...", scale[:, count:], leaf[:, :modes]), by_change
        )
        single = self.variables.localize(variables)[:, :count]
        path = altered_paths(path, self.alterations)
        emg, parts = altered_emg(self.recording.emg, self.alterations), muscle_alterations(self.alterations)
        return single, path, unit_modes, scale[:, :count], self.variables.base, emg, parts

    def _muscle_outputs(self, single, path, scale, base, emg, parts):
        """What the residuals are made of, for one muscle."""
        parameters = self.variables.insert(base, single * scale)
        state = muscle_state_along(path, self.curves, parameters, emg, self.recording.padding, parts)
        return state.moment, tuple(restraint.read(parameters, state) for restraint in self._restraints)

    def _muscle_slopes(self, inputs: tuple):
        """Values and derivatives by local variables, of every muscle."""
        differentiate = slopes_through_time if self.alterations else slopes

        def of_one(single, path, modes, *inputs):
            (moment, quantities), (moment_slope, quantity_slopes) = differentiate(
                lambda single, path: self._muscle_outputs(single, path, *inputs), single, path, modes
            )
            reductions = [restraint.reduce for restraint in self._restraints]
            values = tuple(map(lambda reduce, one: reduce(one), reductions, quantities))
            value_slopes = tuple(map(lambda reduce, one: jax.vmap(reduce)(one), reductions, quantity_slopes))
            flat = moment_slope.reshape(moment_slope.shape[0], -1)
            return moment, values, self.row_scale()[None] * flat, value_slopes

        return jax.vmap(of_one)(*inputs)

    def _muscle_curvatures(
        self,
        inputs: tuple,
        rows: Float[Array, " row"],
        multipliers: tuple[Float[Array, "muscle _"], ...],
    ) -> Float[Array, "muscle local local"]:
        """Sum of residuals times their Hessians: one block a muscle, for moments add linearly.

        Moments are linear in the moment arms too. So arms are first summed over coordinates, each weighted
        by the residual of its moment; and what is read off the arms alone has no second derivatives.
        """
        weights = (self.row_scale() * rows).reshape(self.measured.shape)
        differentiate = curvature_through_time if self.alterations else curvature

        def lever(path: PathState) -> PathState:
            arm = jnp.einsum("tcf,...tcf->...tf", weights, path.moment_arm)
            return replace(path, moment_arm=arm[..., None, :])

        def of_one(own, single, path, modes, *inputs):
            def weighted(single, path):
                moment, quantities = self._muscle_outputs(single, path, *inputs)
                total = jnp.sum(moment)
                for multiplier, restraint, quantity in zip(own, self._restraints, quantities, strict=True):
                    if quantity.ndim < 3:
                        total += multiplier @ restraint.reduce(quantity)
                return total

            return differentiate(weighted, single, lever(path), lever(modes))

        return jax.vmap(of_one)(multipliers, *inputs)

    def _path_curvatures(
        self,
        variables: Float[Array, " variable"],
        inputs: tuple,
        rows: Float[Array, " row"],
        multipliers: tuple[Float[Array, "muscle _"], ...],
    ) -> Float[Array, "muscle local local"]:
        """What curved paths add to the same sum: slopes of everything by the path times its Hessians."""
        weights = (self.row_scale() * rows).reshape(self.measured.shape)
        count = self.variables.nonpath_count

        def of_one(own, single, path, modes, *inputs):
            def weighted(path):
                moment, quantities = self._muscle_outputs(single, path, *inputs)
                total = jnp.vdot(weights, moment)
                for multiplier, restraint, quantity in zip(own, self._restraints, quantities, strict=True):
                    total += multiplier @ restraint.reduce(quantity)
                return total

            return jax.grad(weighted)(path)

        changes = self.variables.unpack(variables).path_changes
        scale = jnp.asarray(self.variables.scale)[:, count:]
        modes = scale.shape[1]
        _, path, unit_modes, *_ = inputs
        by_change = jax.tree.map(lambda leaf: jnp.einsum("mk,mk...->mk...", 1.0 / scale, leaf), unit_modes)
        by_path = jax.vmap(of_one)(multipliers, *inputs)
        curvature = self.recording.path.curvature(changes, by_path, (path, by_change))
        block = scale[:, :, None] * curvature[:, :modes, :modes] * scale[:, None, :]
        return jnp.zeros((len(scale), count + modes, count + modes)).at[:, count:, count:].set(block)

    def row_scale(self) -> Float[Array, " row"]:
        """Turn a moment in N m into a residual."""
        error = jnp.broadcast_to(jnp.asarray(self.moment_error), self.measured.shape)
        return (1.0 / (error * np.sqrt(self.measured.size))).ravel()

    def _moment_rows(self, modelled: Float[Array, "trial coordinate frame"]) -> Float[Array, " row"]:
        modelled = altered_moments(modelled, self.alterations)
        return self.row_scale() * (modelled - self.measured).ravel()

    def _prior_weight(self) -> Float[Array | np.ndarray, " variable"]:
        """One over prior deviation and the root of how many variables of its kind there are."""
        kinds = [label.rsplit(".", 1)[1] for label in self.variables.labels]
        counts = np.array([kinds.count(kind) for kind in kinds])
        return self.variables.prior_precision / np.sqrt(counts)

    def _prior_rows(self, variables: Float[Array, " variable"]) -> Float[Array, " variable"]:
        return jnp.asarray(self._prior_weight()) * (variables - self.variables.prior_mean)
