//! How is a message type written down? Its name and its text in the language of .msg files, derived from the Rust struct.

/// The texts of a message type and of the types inside it, each once.
#[derive(Debug, Default)]
pub(crate) struct Definitions {
    entries: Vec<(String, String)>,
}

impl Definitions {
    /// Adds a message and its fields (type, name). False if it is known already.
    pub(crate) fn add(&mut self, name: String, fields: &[(String, &str)]) -> bool {
        if self.entries.iter().any(|(known, _)| *known == name) {
            return false;
        }
        let line = |(kind, field): &(String, &str)| {
            // `type` is a keyword of Rust.
            format!("{kind} {}\n", field.trim_start_matches("r#"))
        };
        self.entries.push((name, fields.iter().map(line).collect()));
        true
    }
}

/// A type that a ROS 2 message can contain.
pub(crate) trait RosType {
    /// Its name in .msg files, with the package if it is a message.
    fn type_name() -> String;

    /// Adds the definitions of the messages inside it.
    fn define(_definitions: &mut Definitions) {}
}

/// The schema of a message in a bag: its fields, and after a line of `=` those of each message inside it.
pub(crate) fn schema_text<M: RosType>() -> String {
    let mut definitions = Definitions::default();
    M::define(&mut definitions);
    let rule = "=".repeat(80);
    let mut text = String::new();
    for (index, (name, fields)) in definitions.entries.iter().enumerate() {
        if index > 0 {
            text += &format!("{rule}\nMSG: {name}\n");
        }
        text += fields;
    }
    text
}

macro_rules! primitives {
    ($($rust:ty => $name:literal),* $(,)?) => {$(
        impl RosType for $rust {
            fn type_name() -> String {
                $name.to_owned()
            }
        }
    )*};
}

primitives! {
    bool => "bool",
    u8 => "uint8",
    i32 => "int32",
    u32 => "uint32",
    f32 => "float32",
    f64 => "float64",
    String => "string",
}

impl<T: RosType> RosType for Vec<T> {
    fn type_name() -> String {
        format!("{}[]", T::type_name())
    }

    fn define(definitions: &mut Definitions) {
        T::define(definitions);
    }
}

impl<const N: usize> RosType for [f64; N] {
    fn type_name() -> String {
        format!("float64[{N}]")
    }
}

impl<const N: usize> RosType for [[f64; N]; N] {
    fn type_name() -> String {
        format!("float64[{}]", N * N)
    }
}

/// Structs of messages: the package, then the fields in their order.
macro_rules! messages {
    ($($(#[$meta:meta])* $package:ident / $name:ident { $($field:ident : $kind:ty),* $(,)? })*) => {$(
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
        pub(crate) struct $name {
            $(pub(crate) $field: $kind,)*
        }

        impl $crate::ros2::messages::definition::RosType for $name {
            fn type_name() -> String {
                concat!(stringify!($package), "/", stringify!($name)).to_owned()
            }

            fn define(definitions: &mut $crate::ros2::messages::definition::Definitions) {
                let fields = [$((
                    <$kind as $crate::ros2::messages::definition::RosType>::type_name(),
                    stringify!($field),
                )),*];
                if definitions.add(Self::type_name(), &fields) {
                    $(<$kind as $crate::ros2::messages::definition::RosType>::define(definitions);)*
                }
            }
        }
    )*};
}
pub(crate) use messages;
