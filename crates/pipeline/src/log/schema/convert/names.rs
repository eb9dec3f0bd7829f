//! How are values of enums named in the log?

/// Maps the values of an enum to their names in the log and back. A value without a name does not compile.
///
/// Names after `|` are those of earlier versions. They are read, but never written.
macro_rules! names {
    ($to:ident, $from:ident: $type:ident { $($value:ident = $name:literal $(| $old:literal)*),+ $(,)? }) => {
        fn $to(value: $type) -> &'static str {
            match value { $($type::$value => $name),+ }
        }
        fn $from(name: &str) -> anyhow::Result<$type> {
            Ok(match name {
                $($name $(| $old)* => $type::$value,)+
                _ => anyhow::bail!(concat!("unknown ", stringify!($type), " in the log: {}"), name),
            })
        }
    };
}
pub(super) use names;
