"""The likelihood of rows that share effects: days and specimens, and offsets of force, surface and radius.

Where a window begins at static contact, velocity has a kink over the offset, and where it vanishes an end. So the
distribution of a given offset is taken in narrow parts, and the likelihood is their mean; in each part rows are linear
(`burrlab.fitting.linear`).

References
----------
Lindstrom and Bates, Nonlinear mixed effects models for repeated measures data, Biometrics 46 (1990).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from burrlab.fitting.calibration import MixedCalibration, RowScatter
from burrlab.fitting.diagnostics import NO_MATTER, HypothesisTest, concluded, rms_off
from burrlab.fitting.likelihood import MODEL_ERROR, Likelihood, MeanFieldModel
from burrlab.fitting.linear import (
    EDGE,
    OFFSETS,
    OWN,
    STEP,
    Component,
    LinearModel,
    MixedEquations,
    Slopes,
    blocks_of,
    moved_by,
    reml,
)
from burrlab.fitting.observations import (
    ALPHA_BOUNDS,
    C_E_RANGE,
    Box,
    Floats,
    Group,
    Observations,
    Rows,
    bounds_of,
)
from burrlab.fitting.profile import Domain
from burrlab.fitting.slices import AlphaSlices, MixtureSlices

_ROUNDS = 30  # of linearising and REML, at most; 4 are usual
_OFF_BOUND = 1.5  # c_e over its bound where a walk begins that an unknown offset would keep there
_SOFTEST = 0.02  # ln c_e of a specimen over what its windows need, at least, where its rows are linear
_WHOLE = 8  # of them, in whole steps, where no specimen has c_e of its own
_STRIDE = 0.5  # longest step of ln c_e and ln alpha
_CLOSE = 1e-8  # step in log c_e and log alpha that ends them
_WALKS, _BETTER = 4, 1.0  # at most; by how much -2 log of the restricted likelihood must fall there
MILLION = np.log(1e6)  # largest logarithm of a ratio between levels
_APART = 0.04  # relative difference of c_e's bound between neighbouring parts of an offset's distribution
_STEPS, _NEAR = 20, 1e-4  # of Gauss-Newton for c_e of specimens, at most; the change of ln c_e that ends them
_PATH = 40  # places of c_e of all, at which that of specimens is found first
_SPAN = 5e-3  # of ln c_e, over half of which rows of specimens are differenced
_PLACES = 400  # of c_e, among which the best fit to curves with free days is sought
_FARTHEST = 0.95  # of the least force, or depth of a press, by which all may be less
_PARTS = 3.0  # standard deviations of an offset that its parts reach
_NO_LAW = 1.0  # variance between groups from which on the law is not that of the data (ours)
_FAR = 0.05  # of ln c_e, from where rows are linear to the fit
_FOLLOW = 0.75  # of a change of c_e that specimens undo, at most (ours)
_BELOW = 0.2  # c_e where a walk begins, over the bound of specimens' windows, which is none of all


def at_best_variances(
    likelihood: Likelihood,
    components: Sequence[Component],
    point: tuple[float, float],
    c_e: tuple[float, float],
) -> tuple["MixedLikelihood", tuple[float, float]]:
    """The likelihood at the best variances, and its best point (c_e, alpha) near a point; `c_e` bounds it.

    With offsets the steps can end at a bound of c_e, or go to and fro on a ridge. So a walk looks for a better place.
    """
    blocks = blocks_of(components)
    mixed, point = _stepped(likelihood, components, point, c_e, _first_shifts(likelihood, components, point))
    walked = not likelihood.model.of_voxels and any(x.quantity in OFFSETS for x in components)
    for _ in range(_WALKS if walked else 0):
        slices = mixed.at(Domain.of(mixed).grid)
        with np.errstate(over="ignore"):
            alpha = slices.best_alpha
        within = (alpha >= ALPHA_BOUNDS[0]) & (alpha <= ALPHA_BOUNDS[1])
        heights = np.where(within & np.isfinite(slices.profile), slices.profile, np.inf)
        lowest = int(heights.argmin())
        place = float(slices.c_e[lowest]), float(alpha[lowest])
        if heights[lowest] == np.inf:
            break
        there = mixed.about(place)
        every, shifts = np.arange(len(there.shifts)), there.shifts.copy()
        effects = there.effects_given(slices.c_e[[lowest]], np.log([[place[1]]]), every)[0][0, 0]
        for component, block in zip(components, blocks, strict=True):
            if component.quantity in OFFSETS:
                _, least, most = _reach(likelihood.observations, component)
                shifts[block] = np.clip(effects[block], least, most)
        moved = moved_by(likelihood, components, shifts)
        # the best offset may have moved the bound
        low = moved.observations.c_e_floor * (1 + EDGE)
        if place[0] < low:
            place = low, place[1] * (low / place[0]) ** likelihood.model.law.ridge_exponent
        equations = reml(LinearModel(moved, components, place, shifts), mixed.equations)
        if equations.criterion() > mixed.equations.criterion() - _BETTER:
            break
        mixed, point = (
            MixedLikelihood(moved, components, place, shifts, equations.scatter2, equations.effect2),
            place,
        )
        if mixed.n_parts == 1:  # linear about the best offset alone
            nearer, end = _stepped(likelihood, components, place, c_e, shifts)
            if nearer.equations.criterion() <= equations.criterion():
                mixed, point = nearer, end
    return mixed, point


def _reach(o: Observations, component: Component) -> tuple[Floats, Floats, float]:
    """Step and lower end of each level's offset, and the upper end: windows stay between 0 and R, presses in the bone."""
    group, levels = component.group, range(len(component.group.levels))

    def least(velocity: Floats, pressed: Floats) -> Floats:
        rows = np.append(velocity, pressed), np.append(group.velocity, group.pressed)
        return np.array([rows[0][rows[1] == k].min(initial=np.inf) for k in levels])

    room, step = 0.5 * np.min(o.radius - o.window[0]), STEP * float(o.radius.max())
    forces, depths = least(o.force, o.pressed), least(o.radius / 6, _FARTHEST * o.pressed_depth)
    steps = np.minimum(step, STEP * least(np.full(len(o.radius), np.inf), o.pressed_depth))
    reach = {
        "force": (STEP * forces, -_FARTHEST * forces, np.inf),
        "surface": (steps, -depths, room),
        "radius": (np.full(len(forces), step), np.full(len(forces), -room), np.inf),
        "c_e": (np.full(len(forces), EDGE), np.full(len(forces), -np.inf), MILLION),
    }
    return reach[component.quantity]


def _stepped(
    likelihood: Likelihood,
    components: Sequence[Component],
    point: tuple[float, float],
    c_e: tuple[float, float],
    shifts: Floats,
) -> tuple["MixedLikelihood", tuple[float, float]]:
    """See `at_best_variances`: by Gauss-Newton steps from a point and `shifts`.

    The rows are linear about the best offsets; those of surface and radius are rounded, so that windows come again.
    """
    moved = moved_by(likelihood, components, shifts)
    if moved is not likelihood:
        eased = moved.observations.c_e_floor / likelihood.observations.c_e_floor
        c_e, point = (c_e[0] * eased, c_e[1] * eased), (point[0] * eased, point[1])
    if point[0] < c_e[0] * (1 + EDGE) and any(x.moves for x in components):
        # an offset that is still unknown drives c_e to the bound of a window, where the rows are not linear
        raised = _OFF_BOUND * max(c_e[0] / point[0], 1.0)
        point = raised * point[0], point[1] * raised**likelihood.model.law.ridge_exponent
    near: MixedEquations | None = None
    # the bound of a specimen's windows is not that of all
    unbound = any(x.random_c_e for x in components)
    last = steps = np.zeros(len(shifts) + 2)
    sizes, most = np.ones(len(steps)), np.full(len(steps), _STRIDE)
    for component, block in zip(components, blocks_of(components), strict=True):
        most[block] = _STRIDE if component.random_c_e else np.inf
    for k in range(_ROUNDS):
        equations = reml(LinearModel(moved, components, point, shifts), near)
        near = equations if k else None
        last, steps = steps, np.clip(-equations.solution - np.append(shifts, [0.0, 0.0]), -most, most)
        # kinks of windows can make whole steps go to and fro
        sizes = _shorter(sizes, steps, last) if unbound else np.full(len(steps), 1.0 if k < _WHOLE else 0.5)
        before, (by_c_e, by_alpha) = point, np.exp(sizes[-2:] * steps[-2:]).tolist()
        bottom = 0.0 if unbound else c_e[0]
        point = float(np.clip(point[0] * by_c_e, bottom, c_e[1])), point[1] * by_alpha
        beside = _moved_shifts(likelihood, components, shifts, sizes[:-2] * steps[:-2])
        lowest = _least_shifts(moved.observations, components, shifts) - np.log(point[0]) + _SOFTEST
        beside = np.maximum(beside, EDGE * np.ceil(lowest / EDGE))
        if (beside != shifts).any():
            shifts, moved = beside, moved_by(likelihood, components, beside)
            hard = moved.observations.c_e_floor
            c_e = max(bottom, hard * (1 + EDGE)), max(c_e[1], hard * (1 + 2 * EDGE))
            point = float(np.clip(point[0], *c_e)), point[1]
        elif np.abs(np.log(np.divide(point, before))).max() < _CLOSE:
            break
        if k == _WHOLE and not unbound and any(x.quantity in OFFSETS for x in components):
            break
    return MixedLikelihood(moved, components, point, shifts, equations.scatter2, equations.effect2), point


def _moved_shifts(
    likelihood: Likelihood, components: Sequence[Component], shifts: Floats, steps: Floats
) -> Floats:
    """What rows are moved by after a step, rounded and within reach; those that hardly change stay."""
    moved, ends = shifts.copy(), shifts + steps
    for component, block in zip(components, blocks_of(components), strict=True):
        if component.moves and not likelihood.model.of_voxels:
            unit, low, high = _reach(likelihood.observations, component)
            far = np.abs(ends[block] - shifts[block]) > 0.75 * unit
            rounded = np.clip(unit * np.round(ends[block] / unit), low, high)
            moved[block] = np.where(far, rounded, shifts[block])
    return moved


def _shorter(sizes: Floats, steps: Floats, last: Floats) -> Floats:
    """Shares of steps that are gone: half as much of one that goes back by over half of the last."""
    return np.where((steps * last < 0) & (np.abs(steps) > 0.5 * np.abs(last)), 0.5 * sizes, sizes)


def _least_shifts(moved: Observations, components: Sequence[Component], shifts: Floats) -> Floats:
    """ln of the lowest c_e at which each specimen's rows have a window; -inf of other effects."""
    least, bounds = np.full(len(shifts), -np.inf), np.log(moved.c_e_bounds())
    for component, block in zip(components, blocks_of(components), strict=True):
        if component.random_c_e:
            rows = component.group.velocity >= 0
            np.maximum.at(least[block], component.group.velocity[rows], bounds[rows])
    return least + shifts


def fitted_again(
    plain: Likelihood, components: Sequence[Component], point: tuple[float, float]
) -> tuple["MixedLikelihood", Domain, tuple[float, float]]:
    """The likelihood of other rows at its best variances, the range of its walk, and its best point near a point."""
    box = bounds_of(plain.observations, None)
    mixed, end = at_best_variances(plain, components, point, (box.lower[0], box.upper[0]))
    return mixed, Domain.of(mixed), end


def _first_shifts(
    likelihood: Likelihood, components: Sequence[Component], point: tuple[float, float]
) -> Floats:
    """0, and ln c_e of data sets that have one each, over the first's: from their velocities as on a ridge."""
    shifts = [np.zeros(len(component.group.levels)) for component in components]
    for component, u in zip(components, shifts, strict=True):
        if component.sought and component.quantity == "c_e":
            faster = np.log(likelihood.observations.velocity) - likelihood.model.log_unit(point[0])
            softer = -faster / likelihood.model.law.ridge_exponent
            for level in range(len(u)):
                own, first = (softer[component.group.velocity == k] for k in (level, -1))
                u[level] = own.mean() - first.mean() if len(own) and len(first) else 0.0
    return np.concatenate([np.empty(0), *shifts])


@dataclass(frozen=True, eq=False)
class _Part:
    """A part of the distribution of offsets: rows moved to its middle, and the effects' variances about it."""

    likelihood: Likelihood
    slopes: Mapping[str, Slopes]
    shifts: Floats  # where its rows are linear; 0 along the direction in which the distribution is parted
    variance: Floats  # of each column in the new basis
    turn: Floats  # change of basis of the effects' columns
    minus2: float  # -2 log of its share
    by: Floats  # what its rows are moved by, a number for each level


class MixedLikelihood(Likelihood):
    """-2 log L of rows that share effects, at given variances; see `Likelihood`.

    Parameters
    ----------
    plain : Likelihood
        Of the rows as they would be with the offsets of `shifts`.
    components : sequence of Component
    point : (c_e, alpha)
        Where the effects' columns are taken [N/mm^2], [1/ms].
    shifts : ndarray
        A number for each level of each component, 0 for those that move no rows.
    scatter2, effect2 : ndarray
        The variances: of each scatter, of each component.
    """

    n_points = 60  # each costs more; walks are closer where the likelihood bends

    def __init__(
        self, plain: Likelihood, components: Sequence[Component], point: tuple[float, float], shifts: Floats,
        scatter2: Floats, effect2: Floats,
    ) -> None:  # fmt: skip
        super().__init__(plain.observations, plain.kind, plain.model, plain.beliefs)
        self.components, self.point, self.shifts, self.plain = tuple(components), point, shifts, plain
        model = LinearModel(plain, components, point, shifts)
        self.linear, self.equations = model, MixedEquations(model, scatter2, effect2)
        self._paths: dict[int, tuple[Floats, Floats]] = {}
        #: which effects are c_e of specimens, and by how much ln c_e of one falls at the fit where that of all rises
        self._of_specimen, self._follow = np.zeros(len(shifts), np.bool_), 0.0
        for component, block in zip(self.components, model.blocks, strict=True):
            if component.sought and component.quantity == "alpha":
                self.own_alpha = np.append(-self.equations.solution[block], 0.0)[component.group.velocity]
            if component.random_c_e and shifts[block].any():
                kept = np.delete(np.arange(len(self.equations.c)), -2)
                falls = (self.equations.inverse(kept)[0] @ self.equations.C[kept, -2])[block]
                falls = np.nan_to_num(falls)  # none where a row has no window at the point
                self._of_specimen[block], self._follow = True, float(np.clip(falls.max(), 0.0, _FOLLOW))
        self._whole = _Part(
            plain, model.slopes, shifts, self.equations.variance[:-2], np.eye(len(shifts)), 0.0, shifts
        )
        self._parts = self._nodes(plain, model) or [self._whole]
        # where an offset's slopes or a specimen's own c_e pass a kink
        self.uneven = bool(model.slopes) or bool(self._of_specimen.any())
        if self.n_parts > 1 or self._of_specimen.any():  # c_e has the widest bounds of all parts
            rows = [part.likelihood.observations for part in self._parts]
            eased = min(o.c_e_floor for o in rows) / self.observations.c_e_floor
            eased *= _BELOW if self._of_specimen.any() else 1.0
            self.observations = replace(self.observations, eased=eased, raised=max(o.ceiling for o in rows))

    def with_windows(self, box: Box) -> Box:
        """The part of a box where each row has a window; specimens keep windows by c_e of their own."""
        bound = self.n_parts == 1 and (self.of_no_law or not self._of_specimen.any())
        hard = self.plain.observations.c_e_floor * (1 + EDGE) if bound else 0.0
        return Box((max(box.lower[0], hard), box.lower[1]), (max(box.upper[0], hard), box.upper[1]))

    def near(self, point: tuple[float, float]) -> bool:
        """Whether rows are linear close to a point and have windows there, or no better place is to be expected."""
        close = abs(np.log(point[0] / self.point[0])) < _FAR and point[0] > self.plain.observations.c_e_floor
        return close or self.n_parts > 1 or self.of_no_law or self.model.of_voxels

    @property
    def of_no_law(self) -> bool:
        """Whether groups differ so much that the law is not that of the data: steps go anywhere then."""
        return bool(self.equations.effect2[self.linear.estimated].max(initial=0.0) > _NO_LAW)

    def centred(self, point: tuple[float, float]) -> "MixedLikelihood":
        """At the same variances with rows of specimens that are linear about their own c_e at a point."""
        if not self._of_specimen.any():
            return self
        lowest = _least_shifts(self.plain.observations, self.components, self.shifts) + 2 * _SPAN
        shifts = np.maximum(
            self._parabola(np.array([point[0]]), self._whole)[1][0], lowest - np.log(point[0])
        )
        moved = moved_by(self.plain, self.components, shifts - self.shifts)
        equations = self.equations
        return MixedLikelihood(moved, self.components, point, shifts, equations.scatter2, equations.effect2)

    def _nodes(self, plain: Likelihood, model: LinearModel) -> "list[_Part]":
        """Parts of the distribution of given offsets, each of which is narrow enough for a linear model.

        Offsets of one level, in units of their standard deviations, are parted along the direction in which they
        move the bounds of windows. N(0, 1) is to 0.1 % a mixture of N(node, narrow^2), where narrow is 0.6 of
        the nodes' distance. Empty where an offset has several levels.
        """
        given = [k for k, x in enumerate(self.components) if x.quantity in OFFSETS and not x.sought]
        blocks = [model.blocks[k] for k in given]
        if not given or any(block.stop - block.start > 1 for block in blocks) or plain.model.of_voxels:
            return []
        by = np.zeros(len(self.shifts))
        for block in blocks:
            by[block] = -self.shifts[block]
        # without the offsets, so that windows come again
        o = moved_by(plain, self.components, by).observations
        row = int(np.argmax(o.c_e_bounds()))
        q, R, end = o.force_exponent, o.radius[row], o.window[1][row]
        relative = {
            "force": 1 / o.force[row],
            "surface": -q / end,
            "radius": (q - 2) / R,
        }  # of c_e's lower bound
        sizes = np.array([float(self.components[k].deviation or 0.0) for k in given])
        along = sizes * [relative[self.components[k].quantity] for k in given]
        if not along.any():  # with q = 2 the radius moves no bound
            return []
        apart = float(np.clip(_APART / np.linalg.norm(along), 0.25, 1.0))
        nodes, narrow = np.arange(-_PARTS, _PARTS + apart / 2, apart), 0.6 * apart
        weights = np.exp(-0.5 * np.square(nodes) / (1 - narrow**2))
        Q = np.linalg.qr(np.column_stack([along / np.linalg.norm(along), np.eye(len(given))]))[0]
        columns = [block.start for block in blocks]
        turn, variance = np.eye(len(self.shifts)), self.equations.variance[:-2].copy()
        turn[np.ix_(columns, columns)] = sizes[:, None] * Q
        variance[columns] = [narrow**2, *[1.0] * (len(given) - 1)]
        # across that direction rows are linear about the best offsets, to half a standard deviation
        across = Q[:, 1:] @ (np.round(2 * Q[:, 1:].T @ (self.shifts[columns] / sizes)) / 2)
        parts = []
        for node, weight in zip(nodes, weights / weights.sum(), strict=True):
            there, shifts, moved = o, self.shifts.copy(), self.shifts.copy()
            shifts[columns], moved[columns] = sizes * across, sizes * (across + Q[:, 0] * node)
            for k, by in zip(given, moved[columns], strict=True):
                there = there.moved(self.components[k].quantity, by, by)
            if min(there.force.min(), there.radius.min()) <= 0:
                continue
            likelihood = plain.of_rows(there)
            slopes = {
                x.quantity: Slopes(
                    likelihood, x.quantity, model.rows, 0.0 if x.sought else narrow * (x.deviation or 0.0)
                )
                for x in self.components
                if x.quantity in OFFSETS
            }
            parts.append(_Part(likelihood, slopes, shifts, variance, turn, -2 * float(np.log(weight)), moved))
        return parts

    def _at(self, stiffness: Floats) -> AlphaSlices:
        """A parabola over log alpha at each c_e, or several; the columns of offsets are those at each c_e."""
        with np.errstate(invalid="ignore"):
            tables = [self._parabola(stiffness, part)[0] for part in self._parts]
            A, B, m, volume = np.stack(tables, axis=1)
        if len(self._parts) == 1:
            return AlphaSlices(stiffness, A[0], B[0], m[0], np.zeros(len(stiffness)), self.n, True, 0.0, True)
        beyond = stiffness >= np.array([[part.likelihood.observations.ceiling] for part in self._parts])
        A = np.where(
            np.isfinite(A) & ~beyond, A + volume + np.array([[part.minus2] for part in self._parts]), np.inf
        )
        return MixtureSlices.of(
            stiffness, A.T, np.where(np.isfinite(B), B, 1.0).T, np.where(np.isfinite(m), m, 0.0).T, self.n
        )

    def effects_given(self, c_e: Floats, log_alpha: Floats, columns: Rows) -> tuple[Floats, Floats]:
        """Means and covariances of some effects at points (c_e, alpha), given the rows, linear about the best offsets.

        Parameters
        ----------
        c_e : ndarray, shape (m,)
        log_alpha : ndarray, shape (m, a)
        columns : ndarray of int, shape (k,)
            Of all levels of all components.

        Returns
        -------
        ndarray, shape (m, a, k), and ndarray, shape (m, k, k)
        """
        shifts = self._parabola(c_e, self._whole)[1]
        _, _, _, rZ, jZ, scale, H = self._products(c_e, self._whole, shifts)
        inner = scale[:, None] * np.linalg.inv(H) * scale
        mean = -np.einsum("mij,maj->mai", inner[:, columns], rZ[:, None] + log_alpha[..., None] * jZ[:, None])
        return np.nan_to_num(mean), inner[:, columns][..., columns]

    def own_values(self, point: tuple[float, float]) -> Floats:
        """Means of all effects at a point, given the rows; c_e of a specimen keeps a window in each of them."""
        c_e, every = np.array([point[0]]), np.arange(len(self.shifts))
        (((values,),), (covariance,)) = self.effects_given(c_e, np.log([[point[1]]]), every)
        own = self._parabola(c_e, self._whole)[1][0]
        held = np.flatnonzero(self._of_specimen & (own > values + _NEAR))
        inverse = np.linalg.pinv(covariance[np.ix_(held, held)], hermitian=True)
        values = values + covariance[:, held] @ inverse @ (own - values)[held]
        values[held] = own[held]  # also where c_e does not differ
        return np.asarray(values)

    def _parabola(self, stiffness: Floats, part: "_Part") -> tuple[list[Floats], Floats]:
        """A, B and m of `AlphaSlices`, and the log of the determinant of the effects' distribution; and the shifts.

        Where c_e of all is another, specimens keep their own in part. The first steps to it begin where it follows c_e
        of all as at the fit, later ones between those found first.
        """
        if not self._of_specimen.any():
            return self._settled(stiffness, part, part.shifts + np.zeros((len(stiffness), 1)))
        if id(part) not in self._paths:
            low = self.observations.c_e_floor
            path = np.geomspace(low, low * C_E_RANGE, _PATH)
            followed = self._follow * np.log(path / self.point[0])[:, None] * self._of_specimen
            self._paths[id(part)] = np.log(path), self._settled(path, part, part.shifts - followed)[1]
        log_c_e, found = self._paths[id(part)]
        begin = [np.interp(np.log(stiffness), log_c_e, of_one) for of_one in found.T]
        return self._settled(stiffness, part, np.stack(begin, axis=-1))

    def _settled(self, stiffness: Floats, part: "_Part", shifts: Floats) -> tuple[list[Floats], Floats]:
        """See `_parabola`: rows of specimens are linear about their best c_e, by Gauss-Newton steps from some."""
        lowest = np.full(shifts.shape, -np.inf)
        if self._of_specimen.any():
            least = _least_shifts(part.likelihood.observations, self.components, part.shifts)
            lowest = least + 2 * _SPAN - np.log(stiffness)[:, None] * self._of_specimen
        shifts, table = np.maximum(shifts, lowest), np.empty((4, len(stiffness)))
        steps, sizes, left = np.zeros(shifts.shape), np.ones(shifts.shape), np.arange(len(stiffness))
        for _ in range(_STEPS):
            rr, rj, jj, rZ, jZ, scale, H = self._products(stiffness[left], part, shifts[left])
            sums = (scale * np.stack([rZ, jZ])).transpose(1, 2, 0)
            undone, drawn = scale * np.linalg.solve(H, sums).transpose(2, 0, 1)
            B = jj - np.sum(drawn * jZ, axis=-1)
            m = -(rj - np.sum(drawn * rZ, axis=-1)) / B
            A = rr - np.sum(undone * rZ, axis=-1) - B * m**2
            volume = np.linalg.slogdet(H)[1] if self.n_parts > 1 else 0.0
            table[:, left] = A, B, m, np.broadcast_to(volume, B.shape)
            off = self._of_specimen * np.nan_to_num(-undone - m[:, None] * drawn - shifts[left])
            last, steps[left] = steps[left], np.clip(off, -_STRIDE, _STRIDE)
            sizes[left] = _shorter(sizes[left], steps[left], last)
            before = shifts[left]
            shifts[left] = np.maximum(before + sizes[left] * steps[left], lowest[left])
            left = left[np.abs(shifts[left] - before).max(axis=1, initial=0.0) >= _NEAR]
            if not len(left):
                break
        return list(table), shifts

    def _products(
        self, stiffness: Floats, part: "_Part", shifts: Floats
    ) -> tuple[Floats, Floats, float, Floats, Floats, Floats, Floats]:
        """Products of residuals r at alpha = 1, their derivative j by log alpha and the effects' columns Z: rr, rj,
        jj, rZ, jZ; and of the effects' covariance given c_e and alpha the scale and the inverse, in units of it.

        Rows are those of `part`, and about c_e of specimens that `shifts` has, shape (len(stiffness), effects)."""
        equations, model, own = self.equations, self.linear, None
        if self._of_specimen.any():
            velocity, pressed = own = self._own_c_e(shifts - part.shifts)
            above, below = (
                [r for _, _, r, _ in part.likelihood.residuals(stiffness, 1.0, (velocity + by, pressed + by))]
                for by in (_SPAN, -_SPAN)
            )
            residuals = [(up + down) / 2 for up, down in zip(above, below, strict=True)]
        else:
            residuals = [r for _, _, r, _ in part.likelihood.residuals(stiffness, 1.0)]
        varying = {name: slopes.at(stiffness, residuals, own) for name, slopes in part.slopes.items()}
        if own:
            varying["c_e"] = [(up - down) / (2 * _SPAN) for up, down in zip(above, below, strict=True)]
        n_points, n_effects = len(stiffness), len(part.shifts)
        rr, rj, jj = np.zeros(n_points), np.zeros(n_points), 0.0
        rZ, jZ = np.zeros((2, n_points, n_effects))
        products = np.zeros((n_points if varying else 1, n_effects, n_effects))
        for k, (r, columns, s2) in enumerate(zip(residuals, model.columns, equations.scatter2, strict=True)):
            j = columns[:, -2]
            effects = []  # of each component: its columns, which level each row has, and the rows' slopes
            for x, block, tables in zip(self.components, model.blocks, model.places, strict=True):
                fixed = x.quantity not in varying or (x.sought and x.quantity == "c_e")
                slope = columns[:, block].sum(axis=1)[None] if fixed else varying[x.quantity][k]
                effects.append((block, tables[k], slope))
                if shifts[..., block].any():
                    r = r - slope * (shifts[..., block] @ tables[k].T)
            for block, places, slope in effects:
                rZ[:, block] += (r * slope) @ places / s2
                jZ[:, block] += (j * slope) @ places / s2
                for other, others, other_slope in effects:
                    pairs = places[:, :, None] * others[:, None]
                    sums = (slope * other_slope) @ pairs.reshape(len(j), -1) / s2
                    products[:, block, other] += sums.reshape(-1, *pairs.shape[1:])
            rr += np.sum(r**2, axis=-1) / s2
            rj += r @ j / s2
            jj += float(j @ j) / s2
        if part is not self._whole:
            rZ, jZ, products = rZ @ part.turn, jZ @ part.turn, part.turn.T @ products @ part.turn
        products[~np.isfinite(products).all(axis=(1, 2))] = 0.0  # no window there
        return rr, rj, jj, rZ, jZ, *equations.scaled(products, part.variance)

    def _own_c_e(self, shifts: Floats) -> tuple[Floats, Floats]:
        """Of each velocity row and pressed row, from shape (points, effects)."""
        ((x, block),) = (
            (x, block) for x, block in zip(self.components, self.linear.blocks, strict=True) if x.random_c_e
        )
        levels = np.concatenate(
            [shifts[:, block], np.zeros((len(shifts), 1))], axis=1
        )  # a level of -1 has none
        return levels[:, x.group.velocity], levels[:, x.group.pressed]

    @property
    def kinks(self) -> Floats:
        """See `Likelihood`; columns of offsets have kinks of their own."""
        around = [part.likelihood for part in self._parts]
        around += [other for part in self._parts for x in part.slopes.values() for other in x.beside]
        rows = [other.observations for other in around]
        kinks = np.concatenate([o.ridge_entries() for o in rows])
        if self.n_parts > 1:
            floors = [o.c_e_floor * (1 + 1e-6) for o in rows]
            kinks = np.array(
                [*kinks, *floors, *(o.ceiling * (1 - 1e-6) for o in rows if np.isfinite(o.ceiling))]
            )
        followed = self.point[0] * (kinks / self.point[0]) ** (1 / (1 - self._follow))
        return np.unique([*kinks, *followed] if self._follow else kinks)

    @property
    def n_parts(self) -> int:
        """Parts that the distribution of offsets is taken in."""
        return len(self._parts)

    def objective(self, c_e: float, alpha: float) -> float:
        """See `Likelihood`: the weighted sum of squares."""
        return max(float(self.at(c_e).minus2(alpha)[0]), 0.0)

    def of_rows(self, observations: Observations, model: MeanFieldModel | None = None) -> Likelihood:
        """See `Likelihood`; at the same variances and offsets."""
        plain = super().of_rows(replace(observations, eased=1.0, raised=None), model)
        components = [component.of_rows(observations) for component in self.components]
        return MixedLikelihood(
            plain, components, self.point, self.shifts, self.equations.scatter2, self.equations.effect2
        )

    def about(self, point: tuple[float, float]) -> "MixedLikelihood":
        """See `Likelihood`."""
        slices = self.at(point[0])
        part = self._parts[int(np.argmin(slices.A[0] + slices.B[0] * (np.log(point[1]) - slices.m[0]) ** 2))]
        apart = np.abs(self._parts[-1].by - self._parts[self.n_parts // 2].by) / max(self.n_parts // 2, 1)
        near = (np.abs(part.by - self.shifts) <= apart * (1 + 1e-9)).all()
        if self.n_parts == 1 or (near and point[0] > self.plain.observations.c_e_floor):
            return self
        low = part.likelihood.observations.c_e_floor * (1 + EDGE)
        if point[0] < low:  # columns are taken where each row has a window
            point = low, point[1] * (low / point[0]) ** self.model.law.ridge_exponent
        return MixedLikelihood(
            part.likelihood, self.components, point, part.by, self.equations.scatter2, self.equations.effect2
        )

    def without(self, component: Component) -> "MixedLikelihood":
        """The likelihood if one component is known to be what it is at the fit."""
        k, others = self.components.index(component), [x for x in self.components if x is not component]
        return MixedLikelihood(
            self.plain, others, self.point, np.delete(self.shifts, self.linear.blocks[k]), self.equations.scatter2,
            np.delete(self.equations.effect2, k),
        )  # fmt: skip

    @property
    def corrected(self) -> Observations:
        """See `Likelihood`; `observations` are moved in steps, and pressed rows here by the rest."""
        o = self.plain.observations
        for x, block in zip(self.components, self.linear.blocks, strict=True):
            if x.quantity in OFFSETS:
                rest = np.append(-self.equations.solution[block] - self.shifts[block], 0.0)
                o = o.moved(x.quantity, np.zeros(len(o.force)), rest[x.group.pressed])
        return o

    def off_curve(self, c_e: float, alpha: float) -> Floats:
        """See `Likelihood`."""
        off = self.plain.off_curve(c_e, alpha)
        for x, block in zip(self.components, self.linear.blocks, strict=True):
            if x.quantity == "alpha":
                off = off - np.append(-self.equations.solution[block], 0.0)[x.group.velocity]
        return off

    def belief_rises(self) -> list[tuple[float, float]]:
        """See `Likelihood`; of the mean field with the voxel engine too, whose table ends near its fit."""
        rises = []
        for name, value, deviation in self.beliefs:
            o = moved_by(self.plain, self.components, -self.shifts).observations
            alone = Likelihood(
                o,
                self.kind,
                MeanFieldModel(o, self.model.shape),
                tuple(other for other in self.beliefs if other[0] != name),
            )
            ends = (o.c_e_floor * (1 + EDGE), o.c_e_floor * C_E_RANGE)
            near = value * np.exp(deviation * np.linspace(-6, 6, 121))
            places = np.geomspace(*ends, 400)
            first = alone.at(places)
            lowest = int(np.nanargmin(first.profile))
            fitted, point = at_best_variances(
                alone, self.components, (float(places[lowest]), float(first.best_alpha[lowest])), ends
            )
            places = np.unique(np.clip([*places, *(near if name == "c_e" else ()), point[0]], *ends))
            slices = fitted.at(places)
            believed = (
                slices.profile + np.square(np.log(places / value) / deviation)
                if name == "c_e"
                else slices.minus2_table(near) + np.square(np.linspace(-6, 6, 121))[:, None]
            )
            freedom = fitted.equations.uncertainty().freedom(
                np.eye(2)[("c_e", "alpha").index(name)], added=deviation**2
            )
            rises.append((float(np.nanmin(believed) - np.nanmin(slices.profile)), freedom))
        return rises

    def calibration(self, c_e: float, alpha: float) -> MixedCalibration:
        """See `Likelihood`."""
        return self.equations.uncertainty()

    def about_curves(self, c_e: float, alpha: float) -> tuple[Floats, Floats]:
        """See `Likelihood`; the effects count as parameters."""
        model, n = self.linear, len(self._single)
        if n and {x.quantity for x in self.components} <= {"alpha"} and not self.model.of_voxels:
            # days that are parameters can put c_e far from the fit, which draws them together
            hard, columns = self.plain.observations.c_e_floor, model.columns[0][:n]
            c_e_walk = np.geomspace(hard * (1 + EDGE), hard * C_E_RANGE, _PLACES)
            basis = scipy.linalg.orth(np.delete(columns, (-3, -1), axis=1))
            walked = self.plain.residuals(c_e_walk, 1.0)[0][2][:, :n]
            lowest = np.argmin(np.sum((walked - walked @ basis @ basis.T) ** 2, axis=1))
            model = LinearModel(self.plain, self.components, (float(c_e_walk[lowest]), alpha), self.shifts)
        J, r = np.split(model.columns[0][:n], [-1], axis=1)
        return J, (r - J @ (np.linalg.pinv(J, rcond=1e-6) @ r))[:, 0]

    def information(self, c_e: float, alpha: float) -> tuple[Floats, tuple[RowScatter, ...], Floats]:
        """See `Likelihood`."""
        equations = self.equations
        total = np.asarray(np.linalg.pinv(equations.M[-2:, -2:]), np.float64)
        scatters = tuple(
            RowScatter(rows.name, rows.n, rows.known, 0.0, 1.0 if rows.known else float(np.sqrt(s2)))
            for rows, s2 in zip(self.linear.rows, equations.scatter2, strict=True)
            if rows.name != "known"
        )
        return total, scatters, total[None]

    def log_likelihood(self, c_e: float, alpha: float) -> float:
        """See `Likelihood`: at the variances of the highest likelihood, not the restricted one."""
        equations, model = self.equations, self.linear
        free, estimated = equations.free, model.estimated

        def height(x: Floats) -> float:
            scatter2, effect2 = equations.scatter2.copy(), equations.effect2.copy()
            scatter2[free] = np.exp(np.maximum(x[: len(free)], 2 * np.log(MODEL_ERROR)))
            effect2[estimated] = np.square(x[len(free) :])
            return MixedEquations(model, scatter2, effect2).criterion(restricted=False)

        begin = np.append(np.log(equations.scatter2[free]), np.sqrt(equations.effect2[estimated]))
        lowest = float(scipy.optimize.minimize(
            height, begin, method="Nelder-Mead", options={"xatol": 1e-5, "fatol": 1e-8}
        ).fun) if len(begin) else height(begin)  # fmt: skip
        return self.log_jacobian() - 0.5 * (lowest + float(model.n.sum() * np.log(2 * np.pi)))


def against_indentation(likelihood: Likelihood, point: tuple[float, float]) -> list[HypothesisTest]:
    """Whether the velocities and an indentation tell the same c_e, for a fit at a point.

    The indentation is given a c_e of its own; -2 log L, at the variances of that fit, rises to where both have one.
    Empty without an indentation, where sets have a c_e each, for residuals in mm/s, and where all rows lie as close to
    the fit as the model's own error explains.
    """
    components: tuple[Component, ...] = ()
    plain = likelihood
    if isinstance(likelihood, MixedLikelihood):
        components = likelihood.components
        plain = moved_by(likelihood.plain, components, -likelihood.shifts)
    o, kind = replace(plain.observations, eased=1.0, raised=None, slow=np.empty((5, 0))), plain.kind
    if not len(o.pressed) or kind == "absolute" or any(x.sought and x.quantity == "c_e" for x in components):
        return []
    by_row = o.pressed / o.pressed_unit  # c_e of each
    if max(rms_off(likelihood, point), np.sqrt(np.mean(np.log(by_row / point[0]) ** 2))) < NO_MATTER:
        return []
    pressed = Group("indentation", ("1",), np.full(len(o.force), -1), np.zeros(len(o.pressed), np.intp))

    rows = Likelihood(o, "log-sigma" if kind == "sigma" else kind, MeanFieldModel(o, plain.model.shape))
    hard, by_indentation = o.c_e_floor, float(np.exp(np.mean(np.log(by_row))))
    ends = hard * (_BELOW if any(x.random_c_e for x in components) else 1 + EDGE), hard * C_E_RANGE
    apart, (c_e, _) = at_best_variances(
        rows,
        (*components, Component(pressed, "c_e", OWN, sought=True)),
        (max(point[0], ends[0]), point[1]),
        ends,
    )
    equations, shifts = apart.equations, apart.shifts[:-1]
    as_one = MixedLikelihood(
        moved_by(rows, components, shifts), components, apart.point, shifts, equations.scatter2, equations.effect2[:-1]
    )  # fmt: skip
    places = np.unique(np.clip([*np.geomspace(*ends, 100), *np.geomspace(c_e, by_indentation, 60)], *ends))
    own_profile = apart.at(places).profile
    rise = float(np.nanmin(as_one.at(places).profile) - np.nanmin(own_profile))
    equations.model.n_fixed = 3  # c_e of the indentation over that of the velocities, too
    nu = equations.uncertainty().freedom(np.array([1.0, 0.0, 0.0]))
    text = (
        f"The velocities alone tell c_e {places[np.nanargmin(own_profile)]:.3g}, the indentation {by_indentation:.3g} "
        "N/mm^2: they {so}, {outcome}."
    )
    return [concluded("indentation, c_e", rise, (1, nu), text, "agree", "contradict each other", 999.0)]
