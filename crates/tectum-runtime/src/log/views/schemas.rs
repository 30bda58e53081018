//! Definitions of the views' types: in ROS 2's language, and in JSON Schema for those that Foxglove and Lichtblick
//! draw.

use super::ViewChannel;

/// `sensor_msgs/msg/JointState`.
pub(super) const JOINT_STATE: &str = "\
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
";

/// The lists of an entity of a scene, by what they hold.
pub(super) const PRIMITIVES: [&str; 8] =
    ["arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models"];

/// The channels of an arm in space: transforms, links, target and path.
pub(super) fn scene_channels() -> [ViewChannel; 4] {
    let json = |topic, schema_name, schema| ViewChannel {
        topic,
        encoding: "json",
        schema_name,
        schema_encoding: "jsonschema",
        schema,
    };
    let scene = |topic| json(topic, "foxglove.SceneUpdate", scene_update());
    [
        json("/transforms", "foxglove.FrameTransforms", frame_transforms()),
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

/// An object with these properties, each a name and its schema.
fn object(title: &str, properties: &[(&str, String)]) -> String {
    let each: Vec<String> = properties.iter().map(|(name, schema)| format!("\"{name}\":{schema}")).collect();
    let title = if title.is_empty() { String::new() } else { format!("\"title\":\"{title}\",") };
    format!("{{{title}\"type\":\"object\",\"properties\":{{{}}}}}", each.join(","))
}

fn list(of: &str) -> String {
    format!("{{\"type\":\"array\",\"items\":{of}}}")
}

fn simple(kind: &str) -> String {
    format!("{{\"type\":\"{kind}\"}}")
}

/// An object whose properties are all numbers.
fn number_object(names: &[&str]) -> String {
    let properties: Vec<(&str, String)> = names.iter().map(|name| (*name, simple("number"))).collect();
    object("", &properties)
}

/// An instant or a duration.
fn time() -> String {
    object("", &[("sec", simple("integer")), ("nsec", simple("integer"))])
}

fn frame_transforms() -> String {
    let transform = object(
        "foxglove.FrameTransform",
        &[
            ("timestamp", time()),
            ("parent_frame_id", simple("string")),
            ("child_frame_id", simple("string")),
            ("translation", number_object(&["x", "y", "z"])),
            ("rotation", number_object(&["x", "y", "z", "w"])),
        ],
    );
    object("foxglove.FrameTransforms", &[("transforms", list(&transform))])
}

/// The lists that the arm leaves empty are described as lists of objects.
fn scene_update() -> String {
    let vector = || number_object(&["x", "y", "z"]);
    let pose = || object("", &[("position", vector()), ("orientation", number_object(&["x", "y", "z", "w"]))]);
    let colour = || number_object(&["r", "g", "b", "a"]);
    let solid = || object("", &[("pose", pose()), ("size", vector()), ("color", colour())]);
    let line = object(
        "",
        &[
            ("type", simple("integer")),
            ("pose", pose()),
            ("thickness", simple("number")),
            ("scale_invariant", simple("boolean")),
            ("points", list(&vector())),
            ("color", colour()),
            ("colors", list(&colour())),
            ("indices", list(&simple("integer"))),
        ],
    );
    let mut properties = vec![
        ("timestamp", time()),
        ("frame_id", simple("string")),
        ("id", simple("string")),
        ("lifetime", time()),
        ("frame_locked", simple("boolean")),
        ("metadata", list(&object("", &[("key", simple("string")), ("value", simple("string"))]))),
    ];
    properties.extend(PRIMITIVES.map(|name| match name {
        "cubes" | "spheres" => (name, list(&solid())),
        "lines" => (name, list(&line)),
        _ => (name, list(&simple("object"))),
    }));
    let deletion = object("", &[("timestamp", time()), ("type", simple("integer")), ("id", simple("string"))]);
    let entity = object("foxglove.SceneEntity", &properties);
    object("foxglove.SceneUpdate", &[("deletions", list(&deletion)), ("entities", list(&entity))])
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

    #[test]
    fn schemas_are_json() {
        for channel in scene_channels() {
            let schema: serde_json::Value = serde_json::from_str(&channel.schema).unwrap();
            assert_eq!((&schema["title"], &schema["type"]), (&channel.schema_name.into(), &"object".into()));
        }
    }
}
