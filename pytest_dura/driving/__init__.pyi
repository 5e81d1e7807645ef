from .bodies import (
    CAR_LENGTH,
    GAP_CAP,
    NO_BODIES,
    TTC_CAP,
    Body,
    BodyList,
    box_gap,
    box_time_to_collision,
)
from .channel_faults import PromptTextParameters
from .episode import DrivingEpisode
from .explanations import SIGNALS, account_measures
from .highway import HighwaySimulator
from .junction import ARM_LENGTH, ARMS, SPEED_LIMIT, all_routes, route
from .lanes import Route, conflict, route_between, routes_of
from .maneuvers import MAX_ACCELERATION, MAX_BRAKING, Command, Maneuver, acceleration_for
from .measures import MEASURES, clearance_time
from .percepts import DISTANCE_TOLERANCE, PLACE, SIZE
from .roads import BUILT_IN, FOUR_WAY, Arm, Road
from .roles.performance import DrivingOracle
from .roles.planners import Aggressive, RuleBased
from .roles.recovery import EmergencyBrake
from .roles.residuals import LIMITS, Snapshot, residuals
from .roles.safety import SEPARATION_CAP, SeparationMonitor
from .roles.security import PlausibilityAssessor
from .scenario import concrete_world
from .scene import Scene
from .sensors import (
    CHANNELS,
    FAULT_TARGETS,
    TRAFFIC_LIGHT,
    EgoState,
    Imu,
    Odometry,
    Pose,
    Sign,
    Waypoint,
    route_map,
    signs,
)
from .signals import PERCEPT_NAMES, percept_at, percept_signals
from .traffic import Ego

__all__ = [
    "ARMS",
    "ARM_LENGTH",
    "BUILT_IN",
    "CAR_LENGTH",
    "CHANNELS",
    "DISTANCE_TOLERANCE",
    "FAULT_TARGETS",
    "FOUR_WAY",
    "GAP_CAP",
    "LIMITS",
    "MAX_ACCELERATION",
    "MAX_BRAKING",
    "MEASURES",
    "NO_BODIES",
    "PERCEPT_NAMES",
    "PLACE",
    "SEPARATION_CAP",
    "SIGNALS",
    "SIZE",
    "SPEED_LIMIT",
    "TRAFFIC_LIGHT",
    "TTC_CAP",
    "Aggressive",
    "Arm",
    "Body",
    "BodyList",
    "Command",
    "DrivingEpisode",
    "DrivingOracle",
    "Ego",
    "EgoState",
    "EmergencyBrake",
    "HighwaySimulator",
    "Imu",
    "Maneuver",
    "Odometry",
    "PlausibilityAssessor",
    "Pose",
    "PromptTextParameters",
    "Road",
    "Route",
    "RuleBased",
    "Scene",
    "SeparationMonitor",
    "Sign",
    "Snapshot",
    "Waypoint",
    "acceleration_for",
    "account_measures",
    "all_routes",
    "box_gap",
    "box_time_to_collision",
    "clearance_time",
    "concrete_world",
    "conflict",
    "percept_at",
    "percept_signals",
    "residuals",
    "route",
    "route_between",
    "route_map",
    "routes_of",
    "signs",
]
