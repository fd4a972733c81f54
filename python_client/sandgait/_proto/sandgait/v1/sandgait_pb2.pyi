from google.protobuf import struct_pb2 as _struct_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class DescribeRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class DescribeResponse(_message.Message):
    __slots__ = ("version", "protocol", "tasks")
    VERSION_FIELD_NUMBER: _ClassVar[int]
    PROTOCOL_FIELD_NUMBER: _ClassVar[int]
    TASKS_FIELD_NUMBER: _ClassVar[int]
    version: str
    protocol: int
    tasks: _containers.RepeatedCompositeFieldContainer[Task]
    def __init__(self, version: _Optional[str] = ..., protocol: _Optional[int] = ..., tasks: _Optional[_Iterable[_Union[Task, _Mapping]]] = ...) -> None: ...

class Task(_message.Message):
    __slots__ = ("id", "summary", "observation", "action", "info", "reward_terms", "max_episode_steps", "control_rate", "options")
    ID_FIELD_NUMBER: _ClassVar[int]
    SUMMARY_FIELD_NUMBER: _ClassVar[int]
    OBSERVATION_FIELD_NUMBER: _ClassVar[int]
    ACTION_FIELD_NUMBER: _ClassVar[int]
    INFO_FIELD_NUMBER: _ClassVar[int]
    REWARD_TERMS_FIELD_NUMBER: _ClassVar[int]
    MAX_EPISODE_STEPS_FIELD_NUMBER: _ClassVar[int]
    CONTROL_RATE_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    id: str
    summary: str
    observation: _containers.RepeatedCompositeFieldContainer[Column]
    action: _containers.RepeatedCompositeFieldContainer[Column]
    info: _containers.RepeatedCompositeFieldContainer[Column]
    reward_terms: int
    max_episode_steps: int
    control_rate: float
    options: _containers.RepeatedCompositeFieldContainer[Option]
    def __init__(self, id: _Optional[str] = ..., summary: _Optional[str] = ..., observation: _Optional[_Iterable[_Union[Column, _Mapping]]] = ..., action: _Optional[_Iterable[_Union[Column, _Mapping]]] = ..., info: _Optional[_Iterable[_Union[Column, _Mapping]]] = ..., reward_terms: _Optional[int] = ..., max_episode_steps: _Optional[int] = ..., control_rate: _Optional[float] = ..., options: _Optional[_Iterable[_Union[Option, _Mapping]]] = ...) -> None: ...

class Column(_message.Message):
    __slots__ = ("name", "unit", "low", "high")
    NAME_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    LOW_FIELD_NUMBER: _ClassVar[int]
    HIGH_FIELD_NUMBER: _ClassVar[int]
    name: str
    unit: str
    low: float
    high: float
    def __init__(self, name: _Optional[str] = ..., unit: _Optional[str] = ..., low: _Optional[float] = ..., high: _Optional[float] = ...) -> None: ...

class Option(_message.Message):
    __slots__ = ("name", "summary", "default_value", "at_reset")
    NAME_FIELD_NUMBER: _ClassVar[int]
    SUMMARY_FIELD_NUMBER: _ClassVar[int]
    DEFAULT_VALUE_FIELD_NUMBER: _ClassVar[int]
    AT_RESET_FIELD_NUMBER: _ClassVar[int]
    name: str
    summary: str
    default_value: _struct_pb2.Value
    at_reset: bool
    def __init__(self, name: _Optional[str] = ..., summary: _Optional[str] = ..., default_value: _Optional[_Union[_struct_pb2.Value, _Mapping]] = ..., at_reset: bool = ...) -> None: ...

class CreateSessionRequest(_message.Message):
    __slots__ = ("task_id", "num_envs", "options", "protocol")
    TASK_ID_FIELD_NUMBER: _ClassVar[int]
    NUM_ENVS_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    PROTOCOL_FIELD_NUMBER: _ClassVar[int]
    task_id: str
    num_envs: int
    options: _struct_pb2.Struct
    protocol: int
    def __init__(self, task_id: _Optional[str] = ..., num_envs: _Optional[int] = ..., options: _Optional[_Union[_struct_pb2.Struct, _Mapping]] = ..., protocol: _Optional[int] = ...) -> None: ...

class CreateSessionResponse(_message.Message):
    __slots__ = ("session_id", "task", "lease_seconds", "warnings")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    LEASE_SECONDS_FIELD_NUMBER: _ClassVar[int]
    WARNINGS_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    task: Task
    lease_seconds: float
    warnings: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, session_id: _Optional[str] = ..., task: _Optional[_Union[Task, _Mapping]] = ..., lease_seconds: _Optional[float] = ..., warnings: _Optional[_Iterable[str]] = ...) -> None: ...

class DescribeSessionRequest(_message.Message):
    __slots__ = ("session_id",)
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    def __init__(self, session_id: _Optional[str] = ...) -> None: ...

class DescribeSessionResponse(_message.Message):
    __slots__ = ("task", "summary")
    TASK_FIELD_NUMBER: _ClassVar[int]
    SUMMARY_FIELD_NUMBER: _ClassVar[int]
    task: Task
    summary: SessionSummary
    def __init__(self, task: _Optional[_Union[Task, _Mapping]] = ..., summary: _Optional[_Union[SessionSummary, _Mapping]] = ...) -> None: ...

class ListSessionsRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class ListSessionsResponse(_message.Message):
    __slots__ = ("sessions",)
    SESSIONS_FIELD_NUMBER: _ClassVar[int]
    sessions: _containers.RepeatedCompositeFieldContainer[SessionSummary]
    def __init__(self, sessions: _Optional[_Iterable[_Union[SessionSummary, _Mapping]]] = ...) -> None: ...

class SessionSummary(_message.Message):
    __slots__ = ("name", "task_id", "num_envs", "attached", "sequence", "idle_seconds")
    NAME_FIELD_NUMBER: _ClassVar[int]
    TASK_ID_FIELD_NUMBER: _ClassVar[int]
    NUM_ENVS_FIELD_NUMBER: _ClassVar[int]
    ATTACHED_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    IDLE_SECONDS_FIELD_NUMBER: _ClassVar[int]
    name: str
    task_id: str
    num_envs: int
    attached: bool
    sequence: int
    idle_seconds: float
    def __init__(self, name: _Optional[str] = ..., task_id: _Optional[str] = ..., num_envs: _Optional[int] = ..., attached: bool = ..., sequence: _Optional[int] = ..., idle_seconds: _Optional[float] = ...) -> None: ...

class RunSessionRequest(_message.Message):
    __slots__ = ("session_id", "sequence", "reset", "step", "attach", "save", "restore", "rollout", "policy_rollout", "render", "observe")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    RESET_FIELD_NUMBER: _ClassVar[int]
    STEP_FIELD_NUMBER: _ClassVar[int]
    ATTACH_FIELD_NUMBER: _ClassVar[int]
    SAVE_FIELD_NUMBER: _ClassVar[int]
    RESTORE_FIELD_NUMBER: _ClassVar[int]
    ROLLOUT_FIELD_NUMBER: _ClassVar[int]
    POLICY_ROLLOUT_FIELD_NUMBER: _ClassVar[int]
    RENDER_FIELD_NUMBER: _ClassVar[int]
    OBSERVE_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    sequence: int
    reset: Reset
    step: Step
    attach: Attach
    save: Save
    restore: Restore
    rollout: Rollout
    policy_rollout: PolicyRollout
    render: Render
    observe: Observe
    def __init__(self, session_id: _Optional[str] = ..., sequence: _Optional[int] = ..., reset: _Optional[_Union[Reset, _Mapping]] = ..., step: _Optional[_Union[Step, _Mapping]] = ..., attach: _Optional[_Union[Attach, _Mapping]] = ..., save: _Optional[_Union[Save, _Mapping]] = ..., restore: _Optional[_Union[Restore, _Mapping]] = ..., rollout: _Optional[_Union[Rollout, _Mapping]] = ..., policy_rollout: _Optional[_Union[PolicyRollout, _Mapping]] = ..., render: _Optional[_Union[Render, _Mapping]] = ..., observe: _Optional[_Union[Observe, _Mapping]] = ...) -> None: ...

class Attach(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Save(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Restore(_message.Message):
    __slots__ = ("snapshot", "sources")
    SNAPSHOT_FIELD_NUMBER: _ClassVar[int]
    SOURCES_FIELD_NUMBER: _ClassVar[int]
    snapshot: bytes
    sources: bytes
    def __init__(self, snapshot: _Optional[bytes] = ..., sources: _Optional[bytes] = ...) -> None: ...

class Rollout(_message.Message):
    __slots__ = ("actions", "trajectories")
    ACTIONS_FIELD_NUMBER: _ClassVar[int]
    TRAJECTORIES_FIELD_NUMBER: _ClassVar[int]
    actions: bytes
    trajectories: bool
    def __init__(self, actions: _Optional[bytes] = ..., trajectories: bool = ...) -> None: ...

class PolicyRollout(_message.Message):
    __slots__ = ("onnx", "steps", "trajectories")
    ONNX_FIELD_NUMBER: _ClassVar[int]
    STEPS_FIELD_NUMBER: _ClassVar[int]
    TRAJECTORIES_FIELD_NUMBER: _ClassVar[int]
    onnx: bytes
    steps: int
    trajectories: bool
    def __init__(self, onnx: _Optional[bytes] = ..., steps: _Optional[int] = ..., trajectories: bool = ...) -> None: ...

class Render(_message.Message):
    __slots__ = ("indices", "width", "height", "ended")
    INDICES_FIELD_NUMBER: _ClassVar[int]
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    ENDED_FIELD_NUMBER: _ClassVar[int]
    indices: _containers.RepeatedScalarFieldContainer[int]
    width: int
    height: int
    ended: bool
    def __init__(self, indices: _Optional[_Iterable[int]] = ..., width: _Optional[int] = ..., height: _Optional[int] = ..., ended: bool = ...) -> None: ...

class Observe(_message.Message):
    __slots__ = ("index", "ended")
    INDEX_FIELD_NUMBER: _ClassVar[int]
    ENDED_FIELD_NUMBER: _ClassVar[int]
    index: int
    ended: bool
    def __init__(self, index: _Optional[int] = ..., ended: bool = ...) -> None: ...

class Reset(_message.Message):
    __slots__ = ("seeds", "mask", "options")
    SEEDS_FIELD_NUMBER: _ClassVar[int]
    MASK_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    seeds: _containers.RepeatedScalarFieldContainer[int]
    mask: bytes
    options: _struct_pb2.Struct
    def __init__(self, seeds: _Optional[_Iterable[int]] = ..., mask: _Optional[bytes] = ..., options: _Optional[_Union[_struct_pb2.Struct, _Mapping]] = ...) -> None: ...

class Step(_message.Message):
    __slots__ = ("actions", "held")
    ACTIONS_FIELD_NUMBER: _ClassVar[int]
    HELD_FIELD_NUMBER: _ClassVar[int]
    actions: bytes
    held: bytes
    def __init__(self, actions: _Optional[bytes] = ..., held: _Optional[bytes] = ...) -> None: ...

class RunSessionResponse(_message.Message):
    __slots__ = ("sequence", "batch", "failure", "attached", "snapshot", "rollout", "pictures", "observation")
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    BATCH_FIELD_NUMBER: _ClassVar[int]
    FAILURE_FIELD_NUMBER: _ClassVar[int]
    ATTACHED_FIELD_NUMBER: _ClassVar[int]
    SNAPSHOT_FIELD_NUMBER: _ClassVar[int]
    ROLLOUT_FIELD_NUMBER: _ClassVar[int]
    PICTURES_FIELD_NUMBER: _ClassVar[int]
    OBSERVATION_FIELD_NUMBER: _ClassVar[int]
    sequence: int
    batch: Batch
    failure: Failure
    attached: Attached
    snapshot: Snapshot
    rollout: RolloutPart
    pictures: Pictures
    observation: Observation
    def __init__(self, sequence: _Optional[int] = ..., batch: _Optional[_Union[Batch, _Mapping]] = ..., failure: _Optional[_Union[Failure, _Mapping]] = ..., attached: _Optional[_Union[Attached, _Mapping]] = ..., snapshot: _Optional[_Union[Snapshot, _Mapping]] = ..., rollout: _Optional[_Union[RolloutPart, _Mapping]] = ..., pictures: _Optional[_Union[Pictures, _Mapping]] = ..., observation: _Optional[_Union[Observation, _Mapping]] = ...) -> None: ...

class Pictures(_message.Message):
    __slots__ = ("pixels",)
    PIXELS_FIELD_NUMBER: _ClassVar[int]
    pixels: bytes
    def __init__(self, pixels: _Optional[bytes] = ...) -> None: ...

class Observation(_message.Message):
    __slots__ = ("header", "row")
    HEADER_FIELD_NUMBER: _ClassVar[int]
    ROW_FIELD_NUMBER: _ClassVar[int]
    header: str
    row: bytes
    def __init__(self, header: _Optional[str] = ..., row: _Optional[bytes] = ...) -> None: ...

class Attached(_message.Message):
    __slots__ = ("last_sequence",)
    LAST_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    last_sequence: int
    def __init__(self, last_sequence: _Optional[int] = ...) -> None: ...

class Snapshot(_message.Message):
    __slots__ = ("data",)
    DATA_FIELD_NUMBER: _ClassVar[int]
    data: bytes
    def __init__(self, data: _Optional[bytes] = ...) -> None: ...

class RolloutPart(_message.Message):
    __slots__ = ("first_step", "steps", "observations", "rewards", "returns", "lengths", "terminated", "truncated", "actions")
    FIRST_STEP_FIELD_NUMBER: _ClassVar[int]
    STEPS_FIELD_NUMBER: _ClassVar[int]
    OBSERVATIONS_FIELD_NUMBER: _ClassVar[int]
    REWARDS_FIELD_NUMBER: _ClassVar[int]
    RETURNS_FIELD_NUMBER: _ClassVar[int]
    LENGTHS_FIELD_NUMBER: _ClassVar[int]
    TERMINATED_FIELD_NUMBER: _ClassVar[int]
    TRUNCATED_FIELD_NUMBER: _ClassVar[int]
    ACTIONS_FIELD_NUMBER: _ClassVar[int]
    first_step: int
    steps: int
    observations: bytes
    rewards: bytes
    returns: bytes
    lengths: bytes
    terminated: bytes
    truncated: bytes
    actions: bytes
    def __init__(self, first_step: _Optional[int] = ..., steps: _Optional[int] = ..., observations: _Optional[bytes] = ..., rewards: _Optional[bytes] = ..., returns: _Optional[bytes] = ..., lengths: _Optional[bytes] = ..., terminated: _Optional[bytes] = ..., truncated: _Optional[bytes] = ..., actions: _Optional[bytes] = ...) -> None: ...

class Batch(_message.Message):
    __slots__ = ("observations", "rewards", "terminated", "truncated", "infos", "final_indices", "final_observations")
    OBSERVATIONS_FIELD_NUMBER: _ClassVar[int]
    REWARDS_FIELD_NUMBER: _ClassVar[int]
    TERMINATED_FIELD_NUMBER: _ClassVar[int]
    TRUNCATED_FIELD_NUMBER: _ClassVar[int]
    INFOS_FIELD_NUMBER: _ClassVar[int]
    FINAL_INDICES_FIELD_NUMBER: _ClassVar[int]
    FINAL_OBSERVATIONS_FIELD_NUMBER: _ClassVar[int]
    observations: bytes
    rewards: bytes
    terminated: bytes
    truncated: bytes
    infos: bytes
    final_indices: bytes
    final_observations: bytes
    def __init__(self, observations: _Optional[bytes] = ..., rewards: _Optional[bytes] = ..., terminated: _Optional[bytes] = ..., truncated: _Optional[bytes] = ..., infos: _Optional[bytes] = ..., final_indices: _Optional[bytes] = ..., final_observations: _Optional[bytes] = ...) -> None: ...

class Failure(_message.Message):
    __slots__ = ("code", "message")
    CODE_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    code: int
    message: str
    def __init__(self, code: _Optional[int] = ..., message: _Optional[str] = ...) -> None: ...

class CloseSessionRequest(_message.Message):
    __slots__ = ("session_id",)
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    def __init__(self, session_id: _Optional[str] = ...) -> None: ...

class CloseSessionResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...
