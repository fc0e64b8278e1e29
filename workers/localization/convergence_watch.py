"""When a localisation is sure: not before it has been for some way, and then as long as it is not refuted."""

from dataclasses import dataclass

from workers.localization.particle_cloud import Cluster


@dataclass(frozen=True)
class ConvergenceSettings:
    """What being sure takes.

    Attributes:
        weight: The best cluster has so much of all weight, ...
        spread_m: ... its particles spread no more than this ...
        spread_rad: ... and this, ...
        agreement: ... and so many returns lie on the map's obstacles, ...
        lasting_m: ... all of it over so much of the way.
        lost_jump_m: Who has been sure is so no more when the estimate jumps farther, ...
        lost_weight: ... when the cluster has less of all weight, ...
        lost_agreement: ... or fewer returns lie on the map's obstacles.
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
    """Looks at one estimate after the other.

    Attributes:
        converged: Whether the newest one is sure.
    """

    def __init__(self, settings: ConvergenceSettings | None = None) -> None:
        self.converged = False
        self._settings = settings or ConvergenceSettings()
        self._since_m: float | None = None

    def judge(self, best: Cluster, jump_m: float, agreement: float, travelled_m: float) -> bool:
        """Tell whether an estimate is sure.

        Args:
            best: Where most particles are.
            jump_m: How far that is from where the last estimate and odometry put the robot.
            agreement: Share of the newest sweep's returns that lie on the map's obstacles.
            travelled_m: How far the robot has come.
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
