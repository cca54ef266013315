"""Definitions of the interfaces that Cardan uses, as in the files of a ROS 2 installation.

Each begins with a line ``@PACKAGE/KIND/NAME``, followed by its ``.msg``, ``.srv`` or ``.action``
file without comments. Fields are in wire order.
"""

TEXT = """\
@builtin_interfaces/msg/Time
int32 sec
uint32 nanosec
@builtin_interfaces/msg/Duration
int32 sec
uint32 nanosec
@std_msgs/msg/Header
builtin_interfaces/Time stamp
string frame_id
@std_msgs/msg/Bool
bool data
@std_msgs/msg/Int8
int8 data
@std_msgs/msg/Int32
int32 data
@std_msgs/msg/UInt8
uint8 data
@std_msgs/msg/Float64
float64 data
@std_msgs/msg/String
string data
@std_msgs/msg/Empty
@std_msgs/msg/MultiArrayDimension
string label
uint32 size
uint32 stride
@std_msgs/msg/MultiArrayLayout
MultiArrayDimension[] dim
uint32 data_offset
@std_msgs/msg/Int8MultiArray
MultiArrayLayout layout
int8[] data
@std_msgs/msg/Int32MultiArray
MultiArrayLayout layout
int32[] data
@std_msgs/msg/Float64MultiArray
MultiArrayLayout layout
float64[] data
@geometry_msgs/msg/Point
float64 x
float64 y
float64 z
@geometry_msgs/msg/Vector3
float64 x
float64 y
float64 z
@geometry_msgs/msg/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1
@geometry_msgs/msg/Pose
Point position
Quaternion orientation
@geometry_msgs/msg/PoseStamped
std_msgs/Header header
Pose pose
@geometry_msgs/msg/Twist
Vector3 linear
Vector3 angular
@geometry_msgs/msg/TwistStamped
std_msgs/Header header
Twist twist
@geometry_msgs/msg/Wrench
Vector3 force
Vector3 torque
@geometry_msgs/msg/WrenchStamped
std_msgs/Header header
Wrench wrench
@geometry_msgs/msg/Vector3Stamped
std_msgs/Header header
Vector3 vector
@geometry_msgs/msg/Transform
Vector3 translation
Quaternion rotation
@geometry_msgs/msg/TransformStamped
std_msgs/Header header
string child_frame_id
Transform transform
@tf2_msgs/msg/TFMessage
geometry_msgs/TransformStamped[] transforms
@sensor_msgs/msg/JointState
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
@sensor_msgs/msg/Joy
std_msgs/Header header
float32[] axes
int32[] buttons
@sensor_msgs/msg/JoyFeedback
uint8 TYPE_LED=0
uint8 TYPE_RUMBLE=1
uint8 TYPE_BUZZER=2
uint8 type
uint8 id
float32 intensity
@sensor_msgs/msg/JoyFeedbackArray
JoyFeedback[] array
@sensor_msgs/msg/Imu
std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
@sensor_msgs/msg/CompressedImage
std_msgs/Header header
string format
uint8[] data
@rosgraph_msgs/msg/Clock
builtin_interfaces/Time clock
@rmw_dds_common/msg/Gid
char[16] data
@rmw_dds_common/msg/NodeEntitiesInfo
string<=256 node_namespace
string<=256 node_name
Gid[] reader_gid_seq
Gid[] writer_gid_seq
@rmw_dds_common/msg/ParticipantEntitiesInfo
Gid gid
NodeEntitiesInfo[] node_entities_info_seq
@rcl_interfaces/msg/Log
byte DEBUG=10
byte INFO=20
byte WARN=30
byte ERROR=40
byte FATAL=50
builtin_interfaces/Time stamp
uint8 level
string name
string msg
string file
string function
uint32 line
@rcl_interfaces/msg/ParameterType
uint8 PARAMETER_NOT_SET=0
uint8 PARAMETER_BOOL=1
uint8 PARAMETER_INTEGER=2
uint8 PARAMETER_DOUBLE=3
uint8 PARAMETER_STRING=4
uint8 PARAMETER_BYTE_ARRAY=5
uint8 PARAMETER_BOOL_ARRAY=6
uint8 PARAMETER_INTEGER_ARRAY=7
uint8 PARAMETER_DOUBLE_ARRAY=8
uint8 PARAMETER_STRING_ARRAY=9
@rcl_interfaces/msg/ParameterValue
uint8 type
bool bool_value
int64 integer_value
float64 double_value
string string_value
byte[] byte_array_value
bool[] bool_array_value
int64[] integer_array_value
float64[] double_array_value
string[] string_array_value
@rcl_interfaces/msg/Parameter
string name
ParameterValue value
@rcl_interfaces/msg/ParameterEvent
builtin_interfaces/Time stamp
string node
Parameter[] new_parameters
Parameter[] changed_parameters
Parameter[] deleted_parameters
@rcl_interfaces/msg/SetParametersResult
bool successful
string reason
@rcl_interfaces/msg/ListParametersResult
string[] names
string[] prefixes
@rcl_interfaces/msg/FloatingPointRange
float64 from_value
float64 to_value
float64 step
@rcl_interfaces/msg/IntegerRange
int64 from_value
int64 to_value
uint64 step
@rcl_interfaces/msg/ParameterDescriptor
string name
uint8 type
string description
string additional_constraints
bool read_only false
bool dynamic_typing false
FloatingPointRange[<=1] floating_point_range
IntegerRange[<=1] integer_range
@rcl_interfaces/srv/GetParameters
string[] names
---
ParameterValue[] values
@rcl_interfaces/srv/GetParameterTypes
string[] names
---
uint8[] types
@rcl_interfaces/srv/SetParameters
Parameter[] parameters
---
SetParametersResult[] results
@rcl_interfaces/srv/SetParametersAtomically
Parameter[] parameters
---
SetParametersResult result
@rcl_interfaces/srv/ListParameters
uint64 DEPTH_RECURSIVE=0
string[] prefixes
uint64 depth
---
ListParametersResult result
@rcl_interfaces/srv/DescribeParameters
string[] names
---
ParameterDescriptor[] descriptors
@type_description_interfaces/msg/FieldType
uint8 type_id 0
uint64 capacity
uint64 string_capacity
string<=255 nested_type_name
@type_description_interfaces/msg/Field
string name
FieldType type
string default_value
@type_description_interfaces/msg/IndividualTypeDescription
string<=255 type_name
Field[] fields
@type_description_interfaces/msg/TypeDescription
IndividualTypeDescription type_description
IndividualTypeDescription[] referenced_type_descriptions
@type_description_interfaces/msg/TypeSource
string type_name
string encoding
string raw_file_contents
@type_description_interfaces/msg/KeyValue
string key
string value
@type_description_interfaces/srv/GetTypeDescription
string type_name
string type_hash
bool include_type_sources true
---
bool successful
string failure_reason
TypeDescription type_description
TypeSource[] type_sources
KeyValue[] extra_information
@std_srvs/srv/Trigger
---
bool success
string message
@std_srvs/srv/SetBool
bool data
---
bool success
string message
@std_srvs/srv/Empty
---
@service_msgs/msg/ServiceEventInfo
uint8 REQUEST_SENT=0
uint8 REQUEST_RECEIVED=1
uint8 RESPONSE_SENT=2
uint8 RESPONSE_RECEIVED=3
uint8 event_type
builtin_interfaces/Time stamp
char[16] client_gid
int64 sequence_number
@diagnostic_msgs/msg/KeyValue
string key
string value
@diagnostic_msgs/msg/DiagnosticStatus
byte OK=0
byte WARN=1
byte ERROR=2
byte STALE=3
byte level
string name
string message
string hardware_id
KeyValue[] values
@diagnostic_msgs/msg/DiagnosticArray
std_msgs/Header header
DiagnosticStatus[] status
@unique_identifier_msgs/msg/UUID
uint8[16] uuid
@action_msgs/msg/GoalInfo
unique_identifier_msgs/UUID goal_id
builtin_interfaces/Time stamp
@action_msgs/msg/GoalStatus
int8 STATUS_UNKNOWN=0
int8 STATUS_ACCEPTED=1
int8 STATUS_EXECUTING=2
int8 STATUS_CANCELING=3
int8 STATUS_SUCCEEDED=4
int8 STATUS_CANCELED=5
int8 STATUS_ABORTED=6
GoalInfo goal_info
int8 status
@action_msgs/msg/GoalStatusArray
GoalStatus[] status_list
@action_msgs/srv/CancelGoal
GoalInfo goal_info
---
int8 ERROR_NONE=0
int8 ERROR_REJECTED=1
int8 ERROR_UNKNOWN_GOAL_ID=2
int8 ERROR_GOAL_TERMINATED=3
int8 return_code
GoalInfo[] goals_canceling
@trajectory_msgs/msg/JointTrajectoryPoint
float64[] positions
float64[] velocities
float64[] accelerations
float64[] effort
builtin_interfaces/Duration time_from_start
@trajectory_msgs/msg/JointTrajectory
std_msgs/Header header
string[] joint_names
JointTrajectoryPoint[] points
@trajectory_msgs/msg/MultiDOFJointTrajectoryPoint
geometry_msgs/Transform[] transforms
geometry_msgs/Twist[] velocities
geometry_msgs/Twist[] accelerations
builtin_interfaces/Duration time_from_start
@trajectory_msgs/msg/MultiDOFJointTrajectory
std_msgs/Header header
string[] joint_names
MultiDOFJointTrajectoryPoint[] points
@control_msgs/msg/JointJog
std_msgs/Header header
string[] joint_names
float64[] displacements
float64[] velocities
float64 duration
@control_msgs/msg/JointTolerance
string name
float64 position
float64 velocity
float64 acceleration
@control_msgs/msg/JointComponentTolerance
string joint_name
uint16 component
float64 position
float64 velocity
float64 acceleration
@control_msgs/action/FollowJointTrajectory
trajectory_msgs/JointTrajectory trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
JointTolerance[] path_tolerance
JointComponentTolerance[] component_path_tolerance
JointTolerance[] goal_tolerance
JointComponentTolerance[] component_goal_tolerance
builtin_interfaces/Duration goal_time_tolerance
---
int32 SUCCESSFUL=0
int32 INVALID_GOAL=-1
int32 INVALID_JOINTS=-2
int32 OLD_HEADER_TIMESTAMP=-3
int32 PATH_TOLERANCE_VIOLATED=-4
int32 GOAL_TOLERANCE_VIOLATED=-5
int32 error_code
string error_string
---
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
string[] multi_dof_joint_names
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
@moveit_msgs/msg/ServoStatus
int8 INVALID=-1
int8 NO_WARNING=0
int8 DECELERATE_FOR_APPROACHING_SINGULARITY=1
int8 HALT_FOR_SINGULARITY=2
int8 DECELERATE_FOR_LEAVING_SINGULARITY=3
int8 DECELERATE_FOR_COLLISION=4
int8 HALT_FOR_COLLISION=5
int8 JOINT_BOUND=6
int8 code
string message
@moveit_msgs/srv/ServoCommandType
int8 JOINT_JOG=0
int8 TWIST=1
int8 POSE=2
int8 command_type
---
bool success
@crtk_msgs/msg/OperatingState
std_msgs/Header header
string state
bool is_homed
bool is_busy
@crtk_msgs/msg/StringStamped
std_msgs/Header header
string string
@rl_cartesian_control_msgs/srv/Inv
geometry_msgs/Pose x
---
std_msgs/Float64MultiArray q
bool success
@cardan_msgs/msg/ArmStatus
std_msgs/Header header
int32 state
string phase
string message
string authority
int32 stream
bool ready
bool moving
float64 lead_used
uint32 trips
string[] limits
@cardan_msgs/msg/RawPacket
uint8 RECEIVED=0
uint8 SENT=1
std_msgs/Header header
string connection
uint8 direction
uint8[] data
@cardan_msgs/msg/OperatorFrame
std_msgs/Header header
float64 age
uint8[] frame
@cardan_msgs/msg/AuthorityRequest
std_msgs/Header header
string source
string owner
string answer
@cardan_msgs/msg/DeviceEdge
uint64 number
float64 stamp
string button
bool pressed
@cardan_msgs/msg/DeviceAbilities
string driver
bool gives_pose
bool gives_axes
bool gives_inertia
bool battery
string[] buttons
string[] further_buttons
string[] feedback
@cardan_msgs/msg/SharedFixture
string shape
float64[] values
@cardan_msgs/msg/SharedForce
uint64 number
float64 answers
bool engaged
float64[9] linear
geometry_msgs/Vector3 offset
float64[9] rotation
float64 force_scale
SharedFixture[] fixtures
geometry_msgs/Vector3 force
geometry_msgs/Vector3[] measured
float64 absorbed
@cardan_msgs/msg/HapticFeedback
uint64 number
string state
string reason
bool rendering
geometry_msgs/Vector3 commanded
geometry_msgs/Vector3 force
float64 largest
float64 peak
float64 energy
float64 delivered
float64 given_peak
float64 damping
float64 derating
float64 age
uint64 faults
@cardan_msgs/msg/SharedDevice
uint8 version
uint64 run
float64 sent
uint64 lessee
string lessee_name
float64 asked
string link
string reason
float64 report
float64[6] axes
string[] buttons
DeviceEdge[] edges
geometry_msgs/Pose[] pose
geometry_msgs/Wrench[] wrench
bool wrench_in_tool
geometry_msgs/Vector3[] inertia
float64[] battery
DeviceAbilities[] abilities
HapticFeedback[] haptic_feedback
@cardan_msgs/msg/DeviceClaim
uint8 version
uint64 lessee
string lessee_name
float64 asked
float64 late
bool wanted
uint64 edges
bool[] led
float64[] rumble
SharedForce[] force
@cardan_msgs/msg/CommandResult
std_msgs/Header header
string command
int64 sequence
string source
string outcome
bool success
string reason
@cardan_msgs/srv/MovePose
geometry_msgs/Pose x
---
bool success
string message
@cardan_msgs/srv/MoveTwist
geometry_msgs/Twist xdot
---
bool success
string message
@cardan_msgs/srv/ExertWrench
geometry_msgs/Wrench fd
---
bool success
string message
@cardan_msgs/srv/Act
int32 NONE=0
int32 OPEN=1
int32 CLOSE=2
int32 STOP=3
int32 action
---
bool success
string message
@cardan_msgs/srv/Wait
float64 timeout
---
bool success
string message
@cardan_msgs/srv/Ask
string request
---
string reply
@cardan_msgs/srv/Stat
---
geometry_msgs/PoseStamped pose
int32 state
bool success
string message
@cardan_msgs/action/MovePose
geometry_msgs/Pose x
---
bool success
string message
---
geometry_msgs/PoseStamped pose
@cardan_msgs/action/MoveTwist
geometry_msgs/Twist xdot
---
bool success
string message
---
geometry_msgs/PoseStamped pose
@cardan_msgs/action/ExertWrench
geometry_msgs/Wrench fd
---
bool success
string message
---
geometry_msgs/PoseStamped pose
@cardan_msgs/action/CompensateGravity
---
bool success
string message
---
geometry_msgs/PoseStamped pose
@yarp_control_msgs/msg/Velocity
string[] names
float64[] velocities
float64[] ref_accelerations
@yarp_control_msgs/msg/PositionDirect
string[] names
float64[] positions
@yarp_control_msgs/msg/Position
string[] names
float64[] positions
float64[] ref_velocities
@yarp_control_msgs/srv/GetMaxFeedback
---
geometry_msgs/Vector3 max_feedback
string response "NOT_SPECIFIED"
bool success
@yarp_control_msgs/srv/GetTransformation
---
geometry_msgs/Transform transform
string response "NOT_SPECIFIED"
bool success
@yarp_control_msgs/srv/SetTransformation
geometry_msgs/Transform transform
---
string response "NOT_SPECIFIED"
bool success
@rosapi/msg/TypeDef
string type
string[] fieldnames
string[] fieldtypes
int32[] fieldarraylen
string[] examples
string[] constnames
string[] constvalues
@rosapi/srv/Topics
---
string[] topics
string[] types
@rosapi/srv/TopicsAndRawTypes
---
string[] topics
string[] types
string[] typedefs_full_text
@rosapi/srv/TopicType
string topic
---
string type
@rosapi/srv/TopicsForType
string type
---
string[] topics
@rosapi/srv/Publishers
string topic
---
string[] publishers
@rosapi/srv/Subscribers
string topic
---
string[] subscribers
@rosapi/srv/Services
---
string[] services
@rosapi/srv/ServiceType
string service
---
string type
@rosapi/srv/ServicesForType
string type
---
string[] services
@rosapi/srv/ServiceNode
string service
---
string node
@rosapi/srv/ServiceProviders
string service
---
string[] providers
@rosapi/srv/Nodes
---
string[] nodes
@rosapi/srv/NodeDetails
string node
---
string[] subscribing
string[] publishing
string[] services
@rosapi/srv/ActionServers
---
string[] action_servers
@rosapi/srv/ActionType
string action
---
string type
@rosapi/srv/Interfaces
---
string[] interfaces
@rosapi/srv/MessageDetails
string type
---
TypeDef[] typedefs
@rosapi/srv/ServiceRequestDetails
string type
---
TypeDef[] typedefs
@rosapi/srv/ServiceResponseDetails
string type
---
TypeDef[] typedefs
@rosapi/srv/ActionGoalDetails
string type
---
TypeDef[] typedefs
@rosapi/srv/ActionResultDetails
string type
---
TypeDef[] typedefs
@rosapi/srv/ActionFeedbackDetails
string type
---
TypeDef[] typedefs
@rosapi/srv/GetTime
---
builtin_interfaces/Time time
@rosapi/srv/GetROSVersion
---
uint8 version
string distro
@rosapi/srv/GetParam
string name
string default_value
---
string value
bool successful
string reason
@rosapi/srv/SetParam
string name
string value
---
bool successful
string reason
@rosapi/srv/DeleteParam
string name
---
bool successful
string reason
@rosapi/srv/HasParam
string name
---
bool exists
@rosapi/srv/GetParamNames
---
string[] names
"""

FEEDBACK_SINCE_KILTED = """\
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
int32 index
string[] multi_dof_joint_names
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
int32 multi_dof_index
"""
"""Feedback of control_msgs/action/FollowJointTrajectory from control_msgs 6.3 on."""
