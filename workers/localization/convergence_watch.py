"""Decides whether a localisation has converged, and whether it has been lost again."""

from dataclasses import dataclass

from robbie_robots.workers.localization.particle_cloud import Cluster


@dataclass(frozen=True)
class ConvergenceSettings:
    """Criteria of convergence and loss.

    Attributes:
        weight: Converged: minimum share of all weight in the best cluster.
        spread_m: Converged: maximum spread of its positions.
        spread_rad: Converged: maximum spread of its headings.
        agreement: Converged: minimum share of returns on the map's obstacles.
        lasting_m: Converged: distance travelled over which all of these must hold.
        lost_jump_m: Lost: the estimate jumps farther than this.
        lost_weight: Lost: the best cluster has a smaller share of all weight.
        lost_agreement: Lost: a smaller share of returns lies on the map's obstacles.
    """

    weight: float = 0.95
    spread_m: float = 0.2
    spread_rad: float = 0.12
    agreement: float = 0.75
    lasting_m: float = 1.0
    lost_jump_m: float = 0.5
    lost_weight: float = 0.5
    lost_agreement: float = 0.5


class ConvergenceWatch:
    """Judges successive estimates.

    Attributes:
        converged: Whether the newest estimate has converged.
    """

    def __init__(self, settings: ConvergenceSettings | None = None) -> None:
        self.converged = False
        self._settings = settings or ConvergenceSettings()
        self._since_m: float | None = None

    def judge(self, best: Cluster, jump_m: float, agreement: float, travelled_m: float) -> bool:
        """Return whether an estimate has converged.

        Args:
            best: Where most particles are.
            jump_m: Distance from the pose predicted by the last estimate and odometry.
            agreement: Share of the newest sweep's returns that lie on the map's obstacles.
            travelled_m: Distance travelled so far.
        """
        settings = self._settings
        if self.converged:
            lost = jump_m > settings.lost_jump_m or best.weight < settings.lost_weight
            lost |= agreement < settings.lost_agreement
            self.converged, self._since_m = not lost, None
            return self.converged
        sure = (
            best.weight >= settings.weight
            and best.spread_m <= settings.spread_m
            and best.spread_rad <= settings.spread_rad
            and agreement >= settings.agreement
        )
        self._since_m = (travelled_m if self._since_m is None else self._since_m) if sure else None
        self.converged = self._since_m is not None and travelled_m - self._since_m >= settings.lasting_m
        return self.converged
