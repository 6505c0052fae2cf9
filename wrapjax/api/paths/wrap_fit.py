"""What a fit knows of cylinders: how paths follow them, and where they leave paths physiological."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from wrapjax.api.paths.cylinders import freed_wraps
from wrapjax.geometry import RAREST_SHARE, Feasibility, InnerLevel
from wrapjax.geometry.physiological import PhysiologicalThresholds
from wrapjax.model import FreedWraps


@dataclass(frozen=True)
class WrapQuality:
    """How one cylinder's samples fared, on samples and poses never used in fitting.

    Parameters
    ----------
    physiological_share
        Of its box.
    balanced_accuracy, false_physiological
        Of its learned limit and the exact margins together, as PGA has both; see
        `wrapjax.geometry.FeasibilityQuality`. The margins are asked in recorded poses, the truth in others.
    learned_balanced_accuracy, learned_false_physiological
        Of the learned limit alone.
    """

    physiological_share: float
    balanced_accuracy: float | None
    false_physiological: float | None
    learned_balanced_accuracy: float | None = None
    learned_false_physiological: float | None = None


@dataclass(frozen=True)
class WrapFit:
    """The inner level of a subject's surrogate, and the limits of its cylinders.

    Parameters
    ----------
    wraps_of
        The cylinders of each muscle, in the order of its path.
    translations
        Half width of each cylinder's box along its axes, m.
    touched
        The cylinders that some muscle lies on in at least one recorded frame.
    inner
        Of all muscles, in the order of ``wraps_of``.
    feasibility
        By cylinder; None where too few samples are of either kind to learn from.
    quality
        By cylinder.
    thresholds
        What counted as physiological.
    """

    wraps_of: dict[str, tuple[str, ...]]
    translations: dict[str, float]
    touched: tuple[str, ...]
    inner: InnerLevel
    feasibility: dict[str, Feasibility | None]
    quality: dict[str, WrapQuality]
    thresholds: PhysiologicalThresholds

    def movable(self, surfaces: str) -> tuple[str, ...]:
        """Name cylinders (of `SURFACES`), but for those whose box is not physiological almost anywhere."""
        among = self.touched if surfaces == "touched" else tuple(self.quality)
        return tuple(name for name in among if self.quality[name].physiological_share >= RAREST_SHARE)

    def freed(self, muscles: Sequence[str], surfaces: str = "touched") -> FreedWraps:
        """Free the movable cylinders of these muscles."""
        own = {wrap for name in muscles for wrap in self.wraps_of[name]}
        translations = {name: self.translations[name] for name in self.movable(surfaces) if name in own}
        return freed_wraps([self.wraps_of[name] for name in muscles], translations)

    def inner_of(self, muscles: Sequence[str], wraps: int) -> InnerLevel:
        """Pick muscles by name, in this order, and as many places for cylinders."""
        rows = np.array([list(self.wraps_of).index(name) for name in muscles])
        return InnerLevel(self.inner.weights[rows, :wraps], self.inner.half_range[rows, :wraps])

    def limits(self, muscles: Sequence[str], wraps: Sequence[str]) -> list[tuple[int, int, Feasibility]]:
        """Say which muscle, at which of its places, each limited cylinder can be read off."""
        found = []
        for wrap in wraps:
            feasibility = self.feasibility[wrap]
            row = next(row for row, name in enumerate(muscles) if wrap in self.wraps_of[name])
            if feasibility is not None:
                found.append((row, self.wraps_of[muscles[row]].index(wrap), feasibility))
        return found

    def arrays(self) -> dict[str, np.ndarray]:
        """Give all arrays by name, for `from_arrays`."""
        stored = {f"inner.{name}": value for name, value in vars(self.inner).items()}
        for wrap, feasibility in self.feasibility.items():
            if feasibility is not None:
                stored |= {f"feasibility.{wrap}.{name}": value for name, value in vars(feasibility).items()}
        return {name: np.asarray(value) for name, value in stored.items() if eqx.is_array_like(value)}

    def content(self) -> dict[str, dict]:
        """Describe each cylinder in plain values."""
        return {
            name: {
                **vars(quality),
                "translation_m": self.translations[name],
                "touched": name in self.touched,
            }
            for name, quality in self.quality.items()
        }


def wrap_fit_from(
    arrays: dict[str, np.ndarray],
    content: dict[str, dict],
    wraps_of: dict[str, list[str]],
    thresholds: dict[str, float],
) -> WrapFit:
    """Put together what `WrapFit.arrays` and `WrapFit.content` took apart."""
    names = ("weights", "half_range")
    inner = InnerLevel(**{name: jnp.asarray(arrays[f"inner.{name}"]) for name in names})
    feasibility: dict[str, Feasibility | None] = {}
    for wrap in content:
        prefix = f"feasibility.{wrap}."
        own = {name.removeprefix(prefix): value for name, value in arrays.items() if name.startswith(prefix)}
        limit = {name: jnp.asarray(value) for name, value in own.items()}
        feasibility[wrap] = Feasibility(**limit) if limit else None
    # Fits made before the learned limit was judged alone do not say how well it does.
    kinds = [field.name for field in fields(WrapQuality)]
    return WrapFit(
        wraps_of={muscle: tuple(wraps) for muscle, wraps in wraps_of.items()},
        translations={wrap: float(entry["translation_m"]) for wrap, entry in content.items()},
        touched=tuple(wrap for wrap, entry in content.items() if entry["touched"]),
        inner=inner,
        feasibility=feasibility,
        quality={
            wrap: WrapQuality(**{kind: entry[kind] for kind in kinds if kind in entry})
            for wrap, entry in content.items()
        },
        thresholds=PhysiologicalThresholds(**thresholds),
    )
