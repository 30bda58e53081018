//! The `sample!` macro: one declaration gives a Rust type, a field table, a `ros2msg` text and a hash.

use std::fmt::Write as _;
use xxhash_rust::xxh3::xxh3_64;

/// One field of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// Name, the same in Rust and in the log.
    pub name: &'static str,
    /// `ros2msg` type of one element.
    pub element: &'static str,
    /// Number of elements; 1 for a scalar.
    pub count: usize,
    /// Offset from the start of the sample, in bytes.
    pub offset: usize,
    /// The field's documentation: one line that starts with a space.
    pub doc: &'static str,
}

/// A fixed-size record with a described layout.
pub trait Sample: bytemuck::Pod {
    /// Versioned type name. It changes whenever the layout or the meaning of a field changes.
    const NAME: &'static str;
    /// Name of the schema in `ros2msg` form, `package/msg/Type`. Definitions leave `msg` out.
    const ROS_NAME: &'static str;
    /// All fields in order.
    const FIELDS: &'static [Field];
    /// The sample's documentation: one line that starts with a space.
    const DOC: &'static str;

    /// The `ros2msg` definition with nested types, for log readers.
    fn ros2msg() -> String {
        let mut text = String::new();
        write_fields(&mut text, Self::FIELDS);
        if Self::FIELDS.iter().any(|f| f.element == super::Header::ELEMENT) {
            let rule = "=".repeat(80);
            let _ = write!(text, "{rule}\nMSG: {}\n", super::Header::ELEMENT);
            write_fields(&mut text, super::Header::FIELDS);
        }
        text
    }
}

/// Writes a `ros2msg` line for each field.
fn write_fields(text: &mut String, fields: &[Field]) {
    for f in fields {
        let element = f.element;
        let _ = match f.count {
            1 => writeln!(text, "{element} {}", f.name),
            n => writeln!(text, "{element}[{n}] {}", f.name),
        };
    }
}

/// A type that a field can have, with its `ros2msg` element type and number of elements.
pub trait FieldElement {
    /// `ros2msg` name of one element.
    const ELEMENT: &'static str;
    /// Number of elements.
    const COUNT: usize = 1;
}

impl FieldElement for u32 {
    const ELEMENT: &'static str = "uint32";
}
impl FieldElement for u64 {
    const ELEMENT: &'static str = "uint64";
}
impl FieldElement for f32 {
    const ELEMENT: &'static str = "float32";
}
impl<T: FieldElement, const N: usize> FieldElement for [T; N] {
    const ELEMENT: &'static str = T::ELEMENT;
    const COUNT: usize = N * T::COUNT;
}

/// Declares a sample: the `repr(C)` type, its name and version, and its description.
macro_rules! sample {
    (
        $(#[doc = $doc:literal])*
        $name:ident, $version:literal { $($(#[doc = $fdoc:literal])* $field:ident: $ty:ty,)+ }
    ) => {
        $(#[doc = $doc])*
        #[repr(C)]
        #[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
        pub struct $name { $($(#[doc = $fdoc])* pub $field: $ty,)+ }

        impl $crate::wire::schema::Sample for $name {
            const NAME: &'static str = concat!("tectum.", stringify!($name), ".v", $version);
            const ROS_NAME: &'static str = concat!("tectum/msg/", stringify!($name));
            const DOC: &'static str = concat!($($doc),*);
            const FIELDS: &'static [$crate::wire::schema::Field] = &[$($crate::wire::schema::Field {
                name: stringify!($field),
                element: <$ty as $crate::wire::schema::FieldElement>::ELEMENT,
                count: <$ty as $crate::wire::schema::FieldElement>::COUNT,
                offset: core::mem::offset_of!($name, $field),
                doc: concat!($($fdoc),*),
            },)+];
        }

        impl Default for $name {
            fn default() -> Self {
                bytemuck::Zeroable::zeroed()
            }
        }

        impl $crate::wire::schema::FieldElement for $name {
            // Without `msg`, because Python's decoder refuses a nested type with it.
            const ELEMENT: &'static str = concat!("tectum/", stringify!($name));
        }
    };
}
pub(super) use sample;

/// Hash over the names, versions, fields and offsets of every sample and board. Two programs with equal hashes
/// agree on every byte that they exchange.
pub fn schema_hash() -> u64 {
    let mut text = String::new();
    fn add<S: Sample>(text: &mut String) {
        let _ = writeln!(text, "{} {}", S::NAME, size_of::<S>());
        for f in S::FIELDS {
            let _ = writeln!(text, "{} {} {} {}", f.name, f.element, f.count, f.offset);
        }
    }
    add::<super::Header>(&mut text);
    add::<super::Observation>(&mut text);
    add::<super::Command>(&mut text);
    add::<super::Ahead>(&mut text);
    add::<super::Learning>(&mut text);
    add::<super::Vision>(&mut text);
    add::<super::Gap>(&mut text);
    add::<super::Control>(&mut text);
    add::<super::Status>(&mut text);
    xxh3_64(text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::{Ahead, Command, Gap, Header, Learning, Observation, Vision};

    /// CDR aligns each primitive to its size, counted from the start of the body. Without implicit padding in
    /// the `repr(C)` layout (`Pod` proves it) and with 8-byte sizes, body and struct have the same bytes.
    fn assert_cdr<S: Sample>() {
        let mut at = 0;
        for f in S::FIELDS {
            assert_eq!(f.offset, at, "{}.{}", S::NAME, f.name);
            let size = match f.element {
                "uint32" | "float32" => 4,
                "uint64" => 8,
                name if name == Header::ELEMENT => size_of::<Header>(),
                other => panic!("unexpected element {other}"),
            };
            assert_eq!(at % size.min(8), 0, "{}.{}", S::NAME, f.name);
            at += size * f.count;
        }
        assert_eq!(at, size_of::<S>());
        assert_eq!(at % 8, 0, "{} must end on 8 bytes", S::NAME);
    }

    #[test]
    fn samples_are_valid_cdr() {
        assert_cdr::<Header>();
        assert_cdr::<Observation>();
        assert_cdr::<Command>();
        assert_cdr::<Ahead>();
        assert_cdr::<Learning>();
        assert_cdr::<Vision>();
        assert_cdr::<Gap>();
    }

    #[test]
    fn definitions_list_every_field_and_nest_the_header() {
        let text = Observation::ros2msg();
        assert!(text.starts_with("tectum/Header header\nfloat32[32] inputs\n"), "{text}");
        assert!(text.contains("MSG: tectum/Header\nuint64 run\n"), "{text}");
        assert!(!Header::ros2msg().contains("MSG:"));
    }

    /// Other languages and old logs depend on the layout. A change here needs a new version.
    #[test]
    fn the_layout_is_stable() {
        let sizes = [size_of::<Header>(), size_of::<Observation>(), size_of::<Command>(), size_of::<Learning>()];
        assert_eq!(sizes, [56, 280, 184, 176]);
        assert_eq!([size_of::<Vision>(), size_of::<Ahead>()], [72, 576]);
    }
}
