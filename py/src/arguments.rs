//! Arguments from Python as numbers, arrays, paths and objects. An error names the argument, what it is and what is expected.

use std::ops::RangeInclusive;
use std::path::PathBuf;

use localize::Stamp;
use numpy::{
    Element, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::PyClass;
use pyo3::exceptions::{PyRuntimeError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::pyclass::boolean_struct::False;
use pyo3::types::{PyBytes, PyDict, PyTuple};

/// Positional and keyword arguments that make an equal object, for pickle and copy.
pub(crate) type Keywords<'py> = (Bound<'py, PyTuple>, Bound<'py, PyDict>);

/// Characters of a value that an error shows.
const SHOWN_MAX: usize = 80;

/// The error of an argument: a value where the type was right, as PyO3's own error says.
pub(crate) fn invalid(
    name: &str,
    value: &Bound<'_, PyAny>,
    expected: &str,
    cause: Option<PyErr>,
) -> PyErr {
    let message = format!("invalid {name}: {} (expected {expected})", describe(value));
    match cause {
        Some(cause) if cause.is_instance_of::<PyTypeError>(value.py()) => {
            PyTypeError::new_err(message)
        }
        _ => PyValueError::new_err(message),
    }
}

/// What an argument is: the type and shape of an array, or the value itself.
fn describe(value: &Bound<'_, PyAny>) -> String {
    if let Ok(array) = value.cast::<PyUntypedArray>() {
        return format!("{} array of shape {:?}", array.dtype(), array.shape());
    }
    let shown = value.repr().map_or_else(
        |_error| value.get_type().to_string(),
        |text| text.to_string(),
    );
    let shown = shown.split_whitespace().collect::<Vec<_>>().join(" ");
    match shown.char_indices().nth(SHOWN_MAX) {
        Some((end, _)) => format!("{}…", &shown[..end]),
        None => shown,
    }
}

/// An argument as a type of Rust.
pub(crate) fn extract<'a, 'py, T: FromPyObject<'a, 'py>>(
    name: &str,
    value: &'a Bound<'py, PyAny>,
    expected: &str,
) -> PyResult<T> {
    value
        .extract::<T>()
        .map_err(|error| invalid(name, value, expected, Some(error.into())))
}

/// An object of this package.
pub(crate) fn instance<'a, 'py, T: PyClass>(
    name: &str,
    value: &'a Bound<'py, PyAny>,
) -> PyResult<&'a Bound<'py, T>> {
    value.cast::<T>().map_err(|error| {
        let expected = format!("a mirrorball.{}", T::NAME);
        invalid(name, value, &expected, Some(error.into()))
    })
}

/// An object whose method changes it. Refused while another thread is in such a method.
pub(crate) fn exclusive<'py, T>(object: &Bound<'py, T>) -> PyResult<PyRefMut<'py, T>>
where
    T: PyClass<Frozen = False>,
{
    object.try_borrow_mut().map_err(|_in_use| {
        let name = T::NAME;
        PyRuntimeError::new_err(format!(
            "this {name} is in use by another thread (expected one {name} per thread)"
        ))
    })
}

/// A path of a file.
pub(crate) fn path(name: &str, value: &Bound<'_, PyAny>) -> PyResult<PathBuf> {
    extract(name, value, "a path")
}

/// A text.
pub(crate) fn text(name: &str, value: &Bound<'_, PyAny>, expected: &str) -> PyResult<String> {
    extract(name, value, expected)
}

/// One of a few words, and what it stands for.
pub(crate) fn choice<const N: usize, T>(
    name: &str,
    value: &Bound<'_, PyAny>,
    choices: [(&str, T); N],
) -> PyResult<T> {
    let words = choices.each_ref().map(|(word, _)| *word);
    let expected = format!("one of {}", words.join(", "));
    let text = text(name, value, &expected)?;
    let found = choices.into_iter().find(|(word, _)| *word == text);
    found
        .map(|(_, meaning)| meaning)
        .ok_or_else(|| invalid(name, value, &expected, None))
}

/// Bytes.
pub(crate) fn bytes<'py>(name: &str, value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyBytes>> {
    extract(name, value, "bytes")
}

/// True or false.
pub(crate) fn flag(name: &str, value: &Bound<'_, PyAny>) -> PyResult<bool> {
    extract(name, value, "True or False")
}

/// A whole number.
pub(crate) fn whole(
    name: &str,
    value: &Bound<'_, PyAny>,
    range: RangeInclusive<u64>,
) -> PyResult<u64> {
    let expected = match *range.end() {
        u64::MAX => format!("a whole number of at least {}", range.start()),
        end => format!("a whole number, {} to {end}", range.start()),
    };
    let number: u64 = extract(name, value, &expected)?;
    if range.contains(&number) {
        return Ok(number);
    }
    Err(invalid(name, value, &expected, None))
}

/// A finite number of 32 bits; 64 of them are kept.
pub(crate) fn number(name: &str, value: &Bound<'_, PyAny>) -> PyResult<f64> {
    checked_number(name, value, "a finite number", |_| true)
}

/// A finite number above zero.
pub(crate) fn positive(name: &str, value: &Bound<'_, PyAny>) -> PyResult<f64> {
    checked_number(name, value, "a number above 0", |number| number > 0.0)
}

/// A number within bounds.
pub(crate) fn number_within(
    name: &str,
    value: &Bound<'_, PyAny>,
    range: RangeInclusive<f64>,
) -> PyResult<f64> {
    let expected = format!("a number, {} to {}", range.start(), range.end());
    checked_number(name, value, &expected, |number| range.contains(&number))
}

fn checked_number(
    name: &str,
    value: &Bound<'_, PyAny>,
    expected: &str,
    accepted: impl Fn(f64) -> bool,
) -> PyResult<f64> {
    let number: f64 = extract(name, value, expected)?;
    if (number as f32).is_finite() && accepted(number) {
        return Ok(number);
    }
    Err(invalid(name, value, expected, None))
}

/// `N` finite numbers.
pub(crate) fn vector<const N: usize>(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[f64; N]> {
    vector_within(name, value, f64::from(f32::MAX))
}

/// `N` numbers of at most this size.
pub(crate) fn vector_within<const N: usize>(
    name: &str,
    value: &Bound<'_, PyAny>,
    largest: f64,
) -> PyResult<[f64; N]> {
    let mut expected = match N {
        2 => "two finite numbers".to_owned(),
        3 => "three finite numbers".to_owned(),
        _ => format!("{N} finite numbers"),
    };
    if largest < f64::from(f32::MAX) {
        expected = format!("{expected}, −{largest} to {largest}");
    }
    let numbers: [f64; N] = extract(name, value, &expected)?;
    if numbers.iter().all(|number| number.abs() <= largest) {
        return Ok(numbers);
    }
    Err(invalid(name, value, &expected, None))
}

/// Numbers as the crates calculate with them.
pub(crate) fn single<const N: usize>(numbers: [f64; N]) -> [f32; N] {
    numbers.map(|number| number as f32)
}

/// A stamp from seconds.
pub(crate) fn stamp(value: &Bound<'_, PyAny>) -> PyResult<Stamp> {
    // Larger values do not fit into nanoseconds.
    let accepted = |seconds: f64| seconds.abs() < 9e9;
    checked_number("stamp_s", value, "seconds, below 9e9", accepted).map(Stamp::from_seconds)
}

/// An array of a type, without conversion.
pub(crate) fn array<'py, T: Element>(
    name: &str,
    value: &Bound<'py, PyAny>,
    expected: &str,
) -> PyResult<PyReadonlyArrayDyn<'py, T>> {
    let array = value.cast::<PyArrayDyn<T>>();
    // `readonly` panics on an array that is being written.
    match array.map(PyArrayMethods::try_readonly) {
        Ok(Ok(array)) => Ok(array),
        _ => Err(invalid(name, value, expected, None)),
    }
}

/// Any array or list of numbers, converted to 64 bits.
fn numbers<'py>(
    name: &str,
    value: &Bound<'py, PyAny>,
    expected: &str,
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    let numpy = value.py().import("numpy")?;
    let found = numpy
        .call_method1("asarray", (value,))
        .map_err(|error| invalid(name, value, expected, Some(error)))?;
    let kind: char = found.getattr("dtype")?.getattr("kind")?.extract()?;
    // Texts and objects would be converted, too: None to NaN, "1" to 1.
    if !matches!(kind, 'b' | 'i' | 'u' | 'f') {
        return Err(invalid(name, value, expected, None));
    }
    let converted = numpy.call_method1("ascontiguousarray", (&found, "float64"))?;
    // A single number has become a list of one.
    let shape: Vec<usize> = found.getattr("shape")?.extract()?;
    Ok(converted.call_method1("reshape", (shape,))?.cast_into()?)
}

/// A list of numbers.
pub(crate) fn column(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
    let expected = "numbers of shape n";
    let found = numbers(name, value, expected)?;
    if found.ndim() != 1 {
        return Err(invalid(name, value, expected, None));
    }
    Ok(found.readonly().as_slice()?.to_vec())
}

/// A list of finite numbers.
pub(crate) fn finite_column(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
    let found = column(name, value)?;
    if found.iter().all(|number| number.is_finite()) {
        return Ok(found);
    }
    let message = format!("invalid {name}: NaN or infinity (expected finite numbers)");
    Err(PyValueError::new_err(message))
}

/// A table of numbers: rows, columns and values of 32 bits. NaN is kept.
pub(crate) fn table(name: &str, value: &Bound<'_, PyAny>) -> PyResult<(usize, usize, Vec<f32>)> {
    let expected = "numbers, rows × columns";
    let found = numbers(name, value, expected)?;
    let [height, width] = *found.shape() else {
        return Err(invalid(name, value, expected, None));
    };
    let values = found
        .readonly()
        .as_slice()?
        .iter()
        .map(|&v| v as f32)
        .collect();
    Ok((height, width, values))
}

/// Rows of `columns` finite numbers, from any array or list of lists of numbers.
pub(crate) fn rows(
    name: &str,
    value: &Bound<'_, PyAny>,
    columns: &[usize],
) -> PyResult<(usize, Vec<f32>)> {
    let counts: Vec<String> = columns.iter().map(ToString::to_string).collect();
    let expected = format!("numbers, n × {}", counts.join(" or n × "));
    let found = numbers(name, value, &expected)?;
    let width = match *found.shape() {
        // An empty list has no second axis.
        [0] => columns[0],
        [_, width] if columns.contains(&width) => width,
        _ => return Err(invalid(name, value, &expected, None)),
    };
    let values: Vec<f32> = found
        .readonly()
        .as_slice()?
        .iter()
        .map(|&v| v as f32)
        .collect();
    if values.iter().all(|value| value.is_finite()) {
        return Ok((width, values));
    }
    let message = format!("invalid {name}: NaN or infinity (expected finite {expected})");
    Err(PyValueError::new_err(message))
}

/// The entries of a list.
pub(crate) fn list<'py>(
    name: &str,
    value: &Bound<'py, PyAny>,
    expected: &str,
) -> PyResult<Vec<Bound<'py, PyAny>>> {
    extract(name, value, expected)
}
