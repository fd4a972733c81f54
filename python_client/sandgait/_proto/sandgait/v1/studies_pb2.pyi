from google.protobuf import struct_pb2 as _struct_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class File(_message.Message):
    __slots__ = ("name", "content")
    NAME_FIELD_NUMBER: _ClassVar[int]
    CONTENT_FIELD_NUMBER: _ClassVar[int]
    name: str
    content: bytes
    def __init__(self, name: _Optional[str] = ..., content: _Optional[bytes] = ...) -> None: ...

class Sand(_message.Message):
    __slots__ = ("medium", "law", "file")
    MEDIUM_FIELD_NUMBER: _ClassVar[int]
    LAW_FIELD_NUMBER: _ClassVar[int]
    FILE_FIELD_NUMBER: _ClassVar[int]
    medium: str
    law: str
    file: File
    def __init__(self, medium: _Optional[str] = ..., law: _Optional[str] = ..., file: _Optional[_Union[File, _Mapping]] = ...) -> None: ...

class Robot(_message.Message):
    __slots__ = ("name", "file")
    NAME_FIELD_NUMBER: _ClassVar[int]
    FILE_FIELD_NUMBER: _ClassVar[int]
    name: str
    file: File
    def __init__(self, name: _Optional[str] = ..., file: _Optional[_Union[File, _Mapping]] = ...) -> None: ...

class Progress(_message.Message):
    __slots__ = ("fraction", "stage", "ahead")
    FRACTION_FIELD_NUMBER: _ClassVar[int]
    STAGE_FIELD_NUMBER: _ClassVar[int]
    AHEAD_FIELD_NUMBER: _ClassVar[int]
    fraction: float
    stage: str
    ahead: int
    def __init__(self, fraction: _Optional[float] = ..., stage: _Optional[str] = ..., ahead: _Optional[int] = ...) -> None: ...

class Table(_message.Message):
    __slots__ = ("columns", "warnings")
    COLUMNS_FIELD_NUMBER: _ClassVar[int]
    WARNINGS_FIELD_NUMBER: _ClassVar[int]
    columns: _containers.RepeatedCompositeFieldContainer[Series]
    warnings: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, columns: _Optional[_Iterable[_Union[Series, _Mapping]]] = ..., warnings: _Optional[_Iterable[str]] = ...) -> None: ...

class Series(_message.Message):
    __slots__ = ("name", "unit", "numbers", "names")
    NAME_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    NUMBERS_FIELD_NUMBER: _ClassVar[int]
    NAMES_FIELD_NUMBER: _ClassVar[int]
    name: str
    unit: str
    numbers: bytes
    names: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, name: _Optional[str] = ..., unit: _Optional[str] = ..., numbers: _Optional[bytes] = ..., names: _Optional[_Iterable[str]] = ...) -> None: ...

class IntrudeRequest(_message.Message):
    __slots__ = ("shape", "chord", "width", "hip_height", "omega", "sand")
    SHAPE_FIELD_NUMBER: _ClassVar[int]
    CHORD_FIELD_NUMBER: _ClassVar[int]
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    HIP_HEIGHT_FIELD_NUMBER: _ClassVar[int]
    OMEGA_FIELD_NUMBER: _ClassVar[int]
    SAND_FIELD_NUMBER: _ClassVar[int]
    shape: str
    chord: float
    width: float
    hip_height: float
    omega: float
    sand: Sand
    def __init__(self, shape: _Optional[str] = ..., chord: _Optional[float] = ..., width: _Optional[float] = ..., hip_height: _Optional[float] = ..., omega: _Optional[float] = ..., sand: _Optional[_Union[Sand, _Mapping]] = ...) -> None: ...

class IntrudeResponse(_message.Message):
    __slots__ = ("table",)
    TABLE_FIELD_NUMBER: _ClassVar[int]
    table: Table
    def __init__(self, table: _Optional[_Union[Table, _Mapping]] = ...) -> None: ...

class WalkRequest(_message.Message):
    __slots__ = ("leg", "frequency", "engine", "sand", "slope_deg", "dt", "robot")
    LEG_FIELD_NUMBER: _ClassVar[int]
    FREQUENCY_FIELD_NUMBER: _ClassVar[int]
    ENGINE_FIELD_NUMBER: _ClassVar[int]
    SAND_FIELD_NUMBER: _ClassVar[int]
    SLOPE_DEG_FIELD_NUMBER: _ClassVar[int]
    DT_FIELD_NUMBER: _ClassVar[int]
    ROBOT_FIELD_NUMBER: _ClassVar[int]
    leg: str
    frequency: _containers.RepeatedScalarFieldContainer[float]
    engine: str
    sand: Sand
    slope_deg: float
    dt: float
    robot: Robot
    def __init__(self, leg: _Optional[str] = ..., frequency: _Optional[_Iterable[float]] = ..., engine: _Optional[str] = ..., sand: _Optional[_Union[Sand, _Mapping]] = ..., slope_deg: _Optional[float] = ..., dt: _Optional[float] = ..., robot: _Optional[_Union[Robot, _Mapping]] = ...) -> None: ...

class WalkResponse(_message.Message):
    __slots__ = ("progress", "table")
    PROGRESS_FIELD_NUMBER: _ClassVar[int]
    TABLE_FIELD_NUMBER: _ClassVar[int]
    progress: Progress
    table: Table
    def __init__(self, progress: _Optional[_Union[Progress, _Mapping]] = ..., table: _Optional[_Union[Table, _Mapping]] = ...) -> None: ...

class Variation(_message.Message):
    __slots__ = ("parameter", "numbers", "names")
    PARAMETER_FIELD_NUMBER: _ClassVar[int]
    NUMBERS_FIELD_NUMBER: _ClassVar[int]
    NAMES_FIELD_NUMBER: _ClassVar[int]
    parameter: str
    numbers: _containers.RepeatedScalarFieldContainer[float]
    names: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, parameter: _Optional[str] = ..., numbers: _Optional[_Iterable[float]] = ..., names: _Optional[_Iterable[str]] = ...) -> None: ...

class SweepRequest(_message.Message):
    __slots__ = ("vary", "set", "robot", "frequency", "sand", "optimize")
    VARY_FIELD_NUMBER: _ClassVar[int]
    SET_FIELD_NUMBER: _ClassVar[int]
    ROBOT_FIELD_NUMBER: _ClassVar[int]
    FREQUENCY_FIELD_NUMBER: _ClassVar[int]
    SAND_FIELD_NUMBER: _ClassVar[int]
    OPTIMIZE_FIELD_NUMBER: _ClassVar[int]
    vary: _containers.RepeatedCompositeFieldContainer[Variation]
    set: _containers.RepeatedCompositeFieldContainer[Variation]
    robot: Robot
    frequency: float
    sand: Sand
    optimize: str
    def __init__(self, vary: _Optional[_Iterable[_Union[Variation, _Mapping]]] = ..., set: _Optional[_Iterable[_Union[Variation, _Mapping]]] = ..., robot: _Optional[_Union[Robot, _Mapping]] = ..., frequency: _Optional[float] = ..., sand: _Optional[_Union[Sand, _Mapping]] = ..., optimize: _Optional[str] = ...) -> None: ...

class SweepResponse(_message.Message):
    __slots__ = ("progress", "table")
    PROGRESS_FIELD_NUMBER: _ClassVar[int]
    TABLE_FIELD_NUMBER: _ClassVar[int]
    progress: Progress
    table: Table
    def __init__(self, progress: _Optional[_Union[Progress, _Mapping]] = ..., table: _Optional[_Union[Table, _Mapping]] = ...) -> None: ...

class EvaluateRequest(_message.Message):
    __slots__ = ("onnx", "gait", "task_id", "options", "seeds", "media", "slopes")
    ONNX_FIELD_NUMBER: _ClassVar[int]
    GAIT_FIELD_NUMBER: _ClassVar[int]
    TASK_ID_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    SEEDS_FIELD_NUMBER: _ClassVar[int]
    MEDIA_FIELD_NUMBER: _ClassVar[int]
    SLOPES_FIELD_NUMBER: _ClassVar[int]
    onnx: File
    gait: str
    task_id: str
    options: _struct_pb2.Struct
    seeds: int
    media: _containers.RepeatedScalarFieldContainer[str]
    slopes: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, onnx: _Optional[_Union[File, _Mapping]] = ..., gait: _Optional[str] = ..., task_id: _Optional[str] = ..., options: _Optional[_Union[_struct_pb2.Struct, _Mapping]] = ..., seeds: _Optional[int] = ..., media: _Optional[_Iterable[str]] = ..., slopes: _Optional[_Iterable[float]] = ...) -> None: ...

class EvaluateResponse(_message.Message):
    __slots__ = ("progress", "table")
    PROGRESS_FIELD_NUMBER: _ClassVar[int]
    TABLE_FIELD_NUMBER: _ClassVar[int]
    progress: Progress
    table: Table
    def __init__(self, progress: _Optional[_Union[Progress, _Mapping]] = ..., table: _Optional[_Union[Table, _Mapping]] = ...) -> None: ...

class DiagnoseRequest(_message.Message):
    __slots__ = ("data", "file", "values")
    DATA_FIELD_NUMBER: _ClassVar[int]
    FILE_FIELD_NUMBER: _ClassVar[int]
    VALUES_FIELD_NUMBER: _ClassVar[int]
    data: File
    file: File
    values: _struct_pb2.Struct
    def __init__(self, data: _Optional[_Union[File, _Mapping]] = ..., file: _Optional[_Union[File, _Mapping]] = ..., values: _Optional[_Union[_struct_pb2.Struct, _Mapping]] = ...) -> None: ...

class DiagnoseResponse(_message.Message):
    __slots__ = ("progress", "diagnosis")
    PROGRESS_FIELD_NUMBER: _ClassVar[int]
    DIAGNOSIS_FIELD_NUMBER: _ClassVar[int]
    progress: Progress
    diagnosis: Diagnosis
    def __init__(self, progress: _Optional[_Union[Progress, _Mapping]] = ..., diagnosis: _Optional[_Union[Diagnosis, _Mapping]] = ...) -> None: ...

class Diagnosis(_message.Message):
    __slots__ = ("report_json", "report_html", "sand_toml", "curves")
    REPORT_JSON_FIELD_NUMBER: _ClassVar[int]
    REPORT_HTML_FIELD_NUMBER: _ClassVar[int]
    SAND_TOML_FIELD_NUMBER: _ClassVar[int]
    CURVES_FIELD_NUMBER: _ClassVar[int]
    report_json: str
    report_html: str
    sand_toml: str
    curves: Table
    def __init__(self, report_json: _Optional[str] = ..., report_html: _Optional[str] = ..., sand_toml: _Optional[str] = ..., curves: _Optional[_Union[Table, _Mapping]] = ...) -> None: ...
