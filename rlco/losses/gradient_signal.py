"""How strong the anchor is against PPO's mean gradient, without a minibatch's noise."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import torch
from tensordict import TensorDict, TensorDictBase, is_tensor_collection
from torch import Tensor

from rlco.errors import DataError
from rlco.keys import REAL, SIM
from rlco.losses.co_training import CoTrainingLoss
from rlco.losses.gradient_agreement import gradient_of, untouched

#: Groups that an interval needs.
LEAST_GROUPS = 3


def gradient_signal(
    loss: CoTrainingLoss,
    sim: Sequence[TensorDictBase],
    real: TensorDictBase,
    *,
    rows: int = 512,
    confidence: float = 0.9,
) -> dict[str, float]:
    r"""Compare the anchor's gradient with the mean of PPO's on the shared actor.

    The gradient :math:`g_k` of a minibatch of PPO is nearly all noise, so its norm says
    little of the mean :math:`\bar g` that training follows. Of K groups of independent
    episodes the noise averages out in products of different groups,

    .. math::

       |\bar g|^2 \approx \frac{|\sum_k g_k|^2 - \sum_k |g_k|^2}{K (K - 1)},

    which is unbiased and may be negative where there is hardly any signal. With the
    gradient h of the anchor on all demonstrations, which has no such noise, it returns

    - ``anchor_strength``, :math:`|h| / |\bar g|`: 1 where the anchor pulls as hard as
      reinforcement learning does on average;
    - ``anchor_cosine``, :math:`\bar g \cdot h / (|\bar g| |h|)`: below 0 they pull
      against each other;

    each with the ends ``_low`` and ``_high`` of an interval: Student's t on the
    jackknife over the groups (Efron and Stein 1981). The strength's ends are those of
    :math:`|\bar g|^2`: ``anchor_strength_high`` is infinite where that interval
    contains 0, and the cosine is then NaN, since PPO's direction is unknown. The
    strength is NaN only where the estimate of :math:`|\bar g|^2` is not positive.
    Cosines are cut at -1 and 1.

    Of 8 episodes expect no more than a lower end of the strength; some 30 groups or
    more say something of direction. The strength is proportional to ``real_coeff``. It
    changes in training, most where a learned standard deviation shrinks under a
    negative log-likelihood: measure it again.

    Nothing changes: neither ``.grad`` nor buffers nor random generators.

    Args:
        loss: The co-training loss, of PPO on ``sim`` and imitation on ``real``.
        sim: K groups of decisions, from different episodes, with advantages: at least
            3. At the policy that collected them PPO's ratio is 1.
        real: All demonstrations of the anchor.
        rows: Rows of one forward pass; passes count by their rows.
        confidence: Coverage of the intervals.

    Raises:
        DataError: There are fewer than three groups.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from rlco.losses import ImitationLoss
        >>> from rlco.policies import GaussianPolicy
        >>> actor = GaussianPolicy(1, chunk=1, action_size=1, hidden=(4,))
        >>> def demos(target):
        ...     return TensorDict(
        ...         {"observation": {"state": torch.ones(1, 1)},
        ...          "vla_action": {"chunk": torch.full((1, 1, 1), target)}}, [1])
        >>> loss = CoTrainingLoss(
        ...     ImitationLoss(actor), ImitationLoss(actor),
        ...     sim_coeff=1.0, real_coeff=0.5)
        >>> found = gradient_signal(loss, [demos(5.0)] * 3, demos(5.0))
        >>> round(found["anchor_strength"], 3), round(found["anchor_cosine"], 3)
        (0.5, 1.0)
    """
    if len(sim) < LEAST_GROUPS:
        raise DataError(
            f"{len(sim)} groups of episodes say nothing of their noise; give at least "
            f"{LEAST_GROUPS}, by more environments in a rollout."
        )
    if not is_tensor_collection(real) or real.get(REAL, None) is not None:
        given = type(real).__name__
        raise DataError(
            f"real is a {given}{' with a root real' if hasattr(real, 'keys') else ''}; "
            "give the demonstrations themselves, a TensorDict of the anchor's rows."
        )
    parameters = loss.shared_parameters()

    def mean(root: str, data: TensorDictBase) -> Tensor:
        if root not in loss.roots:
            count = sum(parameter.numel() for parameter in parameters)
            return torch.zeros(count, dtype=torch.float64)
        total = torch.zeros((), dtype=torch.float64)
        for part in data.split(rows):
            terms = loss.terms_of(root, TensorDict({root: part}))
            gradient = torch.cat([g.flatten() for g in gradient_of(terms, parameters)])
            total = total + gradient.double() * (len(part) / len(data))
        return total

    with untouched(loss), torch.enable_grad():
        groups = torch.stack([mean(SIM, group) for group in sim])
        anchor = mean(REAL, real)
    return signal_of(groups, anchor, confidence=confidence)


def signal_of(
    groups: Tensor, anchor: Tensor, *, confidence: float = 0.9
) -> dict[str, float]:
    """Return what :func:`gradient_signal` does, of gradients.

    Args:
        groups: PPO's gradient on each group of episodes, (K, parameters).
        anchor: The anchor's gradient, (parameters,).
        confidence: Coverage of the intervals.

    Example:
        >>> groups = torch.tensor([[1.0, 3.0], [1.0, -3.0], [1.0, 0.0]])
        >>> found = signal_of(groups, torch.tensor([0.5, 0.0]))
        >>> round(groups.norm(dim=1).mean().item(), 2), found["anchor_strength_high"]
        (2.44, inf)
    """
    products = groups @ groups.T
    onto = groups @ anchor
    size = float(anchor.norm())

    def square(kept: Tensor) -> float:
        """Return the square of the mean's norm, unbiased."""
        chosen = products[kept][:, kept]
        count = len(kept)
        return float(chosen.sum() - chosen.trace()) / (count * (count - 1))

    def cosine(kept: Tensor) -> float:
        squared = square(kept)
        if squared <= 0.0 or size == 0.0:
            return math.nan
        return float(onto[kept].mean()) / (math.sqrt(squared) * size)

    squared, low, high = jackknife(square, len(groups), confidence)
    cosines: tuple[float, ...] = (math.nan,) * 3
    if low > 0.0:
        cosines = tuple(map(_cut, jackknife(cosine, len(groups), confidence)))
    names = ("anchor_cosine", "anchor_cosine_low", "anchor_cosine_high")
    return {
        "anchor_strength": _over(size, squared) if squared > 0.0 else math.nan,
        "anchor_strength_low": _over(size, high),
        "anchor_strength_high": _over(size, low),
        **dict(zip(names, cosines, strict=True)),
    }


def _cut(cosine: float) -> float:
    """Return an estimate of a cosine that is one; NaN stays."""
    return cosine if math.isnan(cosine) else min(1.0, max(-1.0, cosine))


def _over(size: float, squared: float) -> float:
    """Return the anchor's norm over that of a mean, infinite where that may be 0."""
    if size == 0.0:
        return 0.0
    return size / math.sqrt(squared) if squared > 0.0 else math.inf


def jackknife(
    statistic: Callable[[Tensor], float], groups: int, confidence: float
) -> tuple[float, float, float]:
    """Return a statistic of groups, and the ends of its interval.

    Student's t with K - 1 degrees of freedom on the jackknife's standard error (Efron
    and Stein 1981): of the mean of K numbers it is the usual interval.

    Args:
        statistic: Of the indices of the groups that are kept.
        groups: K.
        confidence: Coverage of the interval.

    Example:
        >>> numbers = torch.tensor([0.7, 0.8, 0.9], dtype=torch.float64)
        >>> mean, low, high = jackknife(lambda k: float(numbers[k].mean()), 3, 0.95)
        >>> f"{mean:.2f} [{low:.2f}, {high:.2f}]"
        '0.80 [0.55, 1.05]'
    """
    from scipy import stats  # a second, for what is measured now and then

    every = torch.arange(groups)
    whole = statistic(every)
    without = [statistic(every[every != left]) for left in range(groups)]
    mean = sum(without) / groups
    variance = (groups - 1) / groups * sum((one - mean) ** 2 for one in without)
    reach = float(stats.t.ppf((1 + confidence) / 2, groups - 1)) * math.sqrt(variance)
    return whole, whole - reach, whole + reach
