//! Definitions of the views' types in ROS 2's language. Those that ROS 2 has itself are word by word its own, so that
//! its programs know them.

use super::ViewChannel;

/// Stands before the definition of each type that the first one uses.
const SEPARATOR: &str = "================================================================================\n";

const JOINT_STATE: &str = "\
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
";

const HEADER: &str = "\
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
";

const TIME: &str = "\
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
";

const DURATION: &str = "\
MSG: builtin_interfaces/Duration
int32 sec
uint32 nanosec
";

const TRANSFORM_STAMPED: &str = "\
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform
";

const TRANSFORM: &str = "\
MSG: geometry_msgs/Transform
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
";

const VECTOR3: &str = "\
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
";

const QUATERNION: &str = "\
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1
";

const POINT: &str = "\
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
";

const POSE: &str = "\
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
";

const COLOR: &str = "\
MSG: std_msgs/ColorRGBA
float32 r
float32 g
float32 b
float32 a
";

const MARKER: &str = "\
MSG: visualization_msgs/Marker
int32 ARROW=0
int32 CUBE=1
int32 SPHERE=2
int32 CYLINDER=3
int32 LINE_STRIP=4
int32 LINE_LIST=5
int32 CUBE_LIST=6
int32 SPHERE_LIST=7
int32 POINTS=8
int32 TEXT_VIEW_FACING=9
int32 MESH_RESOURCE=10
int32 TRIANGLE_LIST=11
int32 ARROW_STRIP=12
int32 ADD=0
int32 MODIFY=0
int32 DELETE=2
int32 DELETEALL=3
std_msgs/Header header
string ns
int32 id
int32 type
int32 action
geometry_msgs/Pose pose
geometry_msgs/Vector3 scale
std_msgs/ColorRGBA color
builtin_interfaces/Duration lifetime
bool frame_locked
geometry_msgs/Point[] points
std_msgs/ColorRGBA[] colors
string texture_resource
sensor_msgs/CompressedImage texture
visualization_msgs/UVCoordinate[] uv_coordinates
string text
string mesh_resource
visualization_msgs/MeshFile mesh_file
bool mesh_use_embedded_materials
";

const COMPRESSED_IMAGE: &str = "\
MSG: sensor_msgs/CompressedImage
std_msgs/Header header
string format
uint8[] data
";

const UV_COORDINATE: &str = "\
MSG: visualization_msgs/UVCoordinate
float32 u
float32 v
";

const MESH_FILE: &str = "\
MSG: visualization_msgs/MeshFile
string filename
uint8[] data
";

/// The inputs in rad, as ROS programs expect joints.
pub(super) fn joint_state_channel() -> ViewChannel {
    let schema = [JOINT_STATE, HEADER, TIME].join(SEPARATOR);
    ViewChannel { topic: "/joint_states", schema_name: "sensor_msgs/msg/JointState", schema }
}

/// The channels of an arm in space: transforms, links, target and path.
pub(super) fn scene_channels() -> [ViewChannel; 4] {
    let sections = ["geometry_msgs/TransformStamped[] transforms\n", TRANSFORM_STAMPED, TRANSFORM];
    let transforms = [&sections[..], &[VECTOR3, QUATERNION, HEADER, TIME]].concat().join(SEPARATOR);
    let sections = ["visualization_msgs/Marker[] markers\n", MARKER, POSE, POINT, QUATERNION, VECTOR3, COLOR];
    let images = [COMPRESSED_IMAGE, UV_COORDINATE, MESH_FILE];
    let markers = [&sections[..], &images, &[DURATION, HEADER, TIME]].concat().join(SEPARATOR);
    let schema_name = "visualization_msgs/msg/MarkerArray";
    let scene = |topic| ViewChannel { topic, schema_name, schema: markers.clone() };
    [
        ViewChannel { topic: "/transforms", schema_name: "tf2_msgs/msg/TFMessage", schema: transforms },
        scene("/scene/links"),
        scene("/scene/target"),
        scene("/scene/path"),
    ]
}

/// A message of 32-bit floating-point numbers, in ROS 2's language. A field's name has lower-case letters, digits and
/// single underscores; the scenario's own name and the unit follow as a comment.
pub(super) fn definition(fields: Vec<(String, String)>) -> String {
    let mut names: Vec<String> = Vec::new();
    let mut text = String::new();
    for (name, unit) in fields {
        let words = name.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
        let mut field = words.collect::<Vec<_>>().join("_").to_ascii_lowercase();
        if !field.starts_with(|c: char| c.is_ascii_lowercase()) {
            field.insert_str(0, "value_");
        }
        while names.contains(&field) {
            field.push('x');
        }
        let comment = if field == name { unit } else { format!("{name} {unit}") };
        text += &format!("float32 {field} # {}\n", comment.replace('\n', " "));
        names.push(field);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_names_that_ros_allows() {
        let field = |name: &str, unit: &str| (name.to_owned(), unit.to_owned());
        let fields =
            vec![field("theta_1", "rad"), field("Speed (left)", "m/s"), field("2nd", ""), field("theta__1", "")];
        assert_eq!(
            definition(fields),
            "float32 theta_1 # rad\nfloat32 speed_left # Speed (left) m/s\nfloat32 value_2nd # 2nd \n\
             float32 theta_1x # theta__1 \n"
        );
    }

    /// Each type that a definition names is defined behind it, once.
    #[test]
    fn definitions_are_complete() {
        for channel in scene_channels().iter().chain([&joint_state_channel()]) {
            let sections: Vec<&str> = channel.schema.split(SEPARATOR).collect();
            let names = sections[1..].iter().map(|section| section.lines().next().unwrap());
            let mut defined: Vec<&str> = names.map(|line| line.strip_prefix("MSG: ").unwrap()).collect();
            let used = channel.schema.lines().filter(|line| !line.starts_with("MSG: ") && !line.contains('='));
            let used = used.map(|line| line.split([' ', '[']).next().unwrap()).filter(|kind| kind.contains('/'));
            let mut used: Vec<&str> = used.collect();
            used.sort_unstable();
            used.dedup();
            defined.sort_unstable();
            assert_eq!(used, defined, "{}", channel.topic);
        }
    }
}
