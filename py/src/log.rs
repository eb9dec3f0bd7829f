//! Logs: a topic's columns as numpy arrays, messages as objects, images as arrays.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use numpy::{IntoPyArray, PyArray3, PyArrayMethods};
use pipeline::log::LogCompleteness;
use pipeline::log::columns::{
    Column, ColumnData, Fields, RawMessage, TimeRange, TopicReader, Value,
};
use pipeline::message_text::error_message;
use pyo3::create_exception;
use pyo3::exceptions::{PyKeyError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyList, PyString};

use crate::arguments;
use crate::errors;
use crate::threads::detached;

create_exception!(
    mirrorball._core,
    LogError,
    PyValueError,
    "The file is no log of mirrorball, or it is damaged."
);

/// Chunks between two checks for Ctrl-C.
const CHUNKS_PER_CHECK: usize = 64;
const IMAGE_TOPIC: &str = "/camera/image";

/// A log's topics. Each call reads the file anew and holds one chunk of it.
#[pyclass(frozen, module = "mirrorball._core")]
pub(crate) struct LogReader {
    reader: Arc<TopicReader>,
}

#[pymethods]
impl LogReader {
    /// Opens a log; a truncated one is read to its last complete chunk.
    #[new]
    fn new(py: Python<'_>, path: &Bound<'_, PyAny>) -> PyResult<Self> {
        let path = arguments::path("path", path)?;
        let reader = detached(py, || TopicReader::open(&path)).map_err(log_error)?;
        Ok(LogReader {
            reader: Arc::new(reader),
        })
    }

    /// False if the log's writer was killed.
    #[getter]
    fn complete(&self) -> bool {
        self.reader.end() == LogCompleteness::Complete
    }

    /// What the log says of its run.
    #[getter]
    fn metadata(&self) -> BTreeMap<String, String> {
        self.reader.metadata().clone()
    }

    /// Messages by topic.
    #[getter]
    fn message_counts(&self) -> BTreeMap<String, u64> {
        let topics = self.reader.topics().iter();
        topics
            .map(|(name, topic)| (name.clone(), topic.messages))
            .collect()
    }

    /// Names of message types by topic.
    #[getter]
    fn schemas(&self) -> BTreeMap<String, String> {
        let topics = self.reader.topics().iter();
        topics
            .map(|(name, topic)| (name.clone(), topic.schema.clone()))
            .collect()
    }

    /// The files that the run was made with.
    fn files<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let files = detached(py, || self.reader.files()).map_err(log_error)?;
        let all = PyDict::new(py);
        for (name, content) in files {
            all.set_item(name, PyBytes::new(py, &content))?;
        }
        Ok(all)
    }

    /// `stamp_s` (log time) and the columns of a topic's messages, from `start_ns` until before `end_ns`.
    #[pyo3(signature = (topic, *, elements, start_s=None, stop_s=None))]
    fn columns<'py>(
        &self,
        py: Python<'py>,
        topic: &Bound<'py, PyAny>,
        elements: &Bound<'py, PyAny>,
        start_s: Option<&Bound<'py, PyAny>>,
        stop_s: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let topic = &self.topic(topic)?;
        let elements: Vec<String> =
            arguments::extract("elements", elements, "a list of names of elements")?;
        let range = time_range(start_s, stop_s)?;
        let read = detached(py, || {
            let check = signal_check();
            self.reader.columns(topic, &elements, &range, check)
        });
        column_arrays(py, read.map_err(log_error)?)
    }

    /// `stamp_s` and the columns of the entries of a list inside a topic's messages.
    #[pyo3(signature = (topic, field, *, start_s=None, stop_s=None))]
    fn rows<'py>(
        &self,
        py: Python<'py>,
        topic: &Bound<'py, PyAny>,
        field: &Bound<'py, PyAny>,
        start_s: Option<&Bound<'py, PyAny>>,
        stop_s: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let topic = &self.topic(topic)?;
        let field = &arguments::text("field", field, "the name of a list")?;
        let range = time_range(start_s, stop_s)?;
        let read = detached(py, || {
            self.reader.rows(topic, field, &range, signal_check())
        });
        column_arrays(py, read.map_err(log_error)?)
    }

    /// Log times of a topic's messages, nanoseconds, ascending.
    fn log_times<'py>(
        &self,
        py: Python<'py>,
        topic: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, numpy::PyArray1<u64>>> {
        let topic = &self.topic(topic)?;
        let times = detached(py, || self.reader.log_times(topic));
        Ok(times.map_err(log_error)?.into_pyarray(py))
    }

    /// Topic, log time (nanoseconds) and content of messages; all topics if none are named.
    #[pyo3(signature = (topics, *, start_s=None, stop_s=None))]
    fn messages(
        &self,
        topics: &Bound<'_, PyAny>,
        start_s: Option<&Bound<'_, PyAny>>,
        stop_s: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<MessageIterator> {
        Ok(MessageIterator(ChunkWalk::new(
            self.reader.clone(),
            arguments::extract("topics", topics, "names of topics")?,
            time_range(start_s, stop_s)?,
        )))
    }

    /// Log times (nanoseconds) and images: rows × columns × (red, green, blue).
    #[pyo3(signature = (*, start_s=None, stop_s=None))]
    fn images(
        &self,
        start_s: Option<&Bound<'_, PyAny>>,
        stop_s: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<ImageIterator> {
        Ok(ImageIterator(ChunkWalk::new(
            self.reader.clone(),
            vec![IMAGE_TOPIC.to_owned()],
            time_range(start_s, stop_s)?,
        )))
    }
}

impl LogReader {
    /// The name of a topic that the log has.
    fn topic(&self, topic: &Bound<'_, PyAny>) -> PyResult<String> {
        let topic = arguments::text("topic", topic, "the name of a topic")?;
        let topics = self.reader.topics();
        if topics.contains_key(&topic) {
            return Ok(topic);
        }
        let with_messages = topics.iter().filter(|(_, topic)| topic.messages > 0);
        let names: Vec<&str> = with_messages.map(|(name, _)| name.as_str()).collect();
        Err(PyKeyError::new_err(format!(
            "{} has no topic {topic}; it has {}",
            self.reader.path().display(),
            names.join(", ")
        )))
    }
}

/// Messages of a log, a chunk at a time.
struct ChunkWalk {
    reader: Arc<TopicReader>,
    topics: Vec<String>,
    range: TimeRange,
    next_chunk: usize,
    pending: VecDeque<RawMessage>,
}

impl ChunkWalk {
    fn new(reader: Arc<TopicReader>, topics: Vec<String>, range: TimeRange) -> Self {
        ChunkWalk {
            reader,
            topics,
            range,
            next_chunk: 0,
            pending: VecDeque::new(),
        }
    }

    fn next(&mut self, py: Python<'_>) -> PyResult<Option<RawMessage>> {
        while self.pending.is_empty() && self.next_chunk < self.reader.chunk_count() {
            py.check_signals()?;
            let chunk = self.next_chunk;
            self.next_chunk += 1;
            let read = detached(py, || {
                self.reader.chunk_messages(chunk, &self.topics, &self.range)
            });
            self.pending = read.map_err(log_error)?.into();
        }
        Ok(self.pending.pop_front())
    }
}

#[pyclass(module = "mirrorball._core")]
pub(crate) struct MessageIterator(ChunkWalk);

#[pymethods]
impl MessageIterator {
    fn __iter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    fn __next__<'py>(
        &mut self,
        py: Python<'py>,
    ) -> PyResult<Option<(String, u64, Bound<'py, PyAny>)>> {
        let Some(message) = self.0.next(py)? else {
            return Ok(None);
        };
        let fields = self.0.reader.decode(&message).map_err(log_error)?;
        let namespace = py.import("types")?.getattr("SimpleNamespace")?;
        let object = message_object(py, &namespace, fields)?;
        Ok(Some((message.topic, message.log_time, object)))
    }
}

#[pyclass(module = "mirrorball._core")]
pub(crate) struct ImageIterator(ChunkWalk);

#[pymethods]
impl ImageIterator {
    fn __iter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    fn __next__<'py>(
        &mut self,
        py: Python<'py>,
    ) -> PyResult<Option<(u64, Bound<'py, PyArray3<u8>>)>> {
        let Some(message) = self.0.next(py)? else {
            return Ok(None);
        };
        let image = detached(py, || {
            message.encoded_image().and_then(|image| image.decode())
        });
        let image = image.map_err(log_error)?;
        let shape = [image.height_px, image.width_px, 3];
        let pixels = image.rgb.into_pyarray(py).reshape(shape)?;
        Ok(Some((message.log_time, pixels)))
    }
}

/// Log times in nanoseconds from start until before stop, seconds.
fn time_range(
    start_s: Option<&Bound<'_, PyAny>>,
    stop_s: Option<&Bound<'_, PyAny>>,
) -> PyResult<TimeRange> {
    let nanoseconds = |name: &str, value: Option<&Bound<'_, PyAny>>| {
        let seconds = value.map(|value| arguments::number(name, value));
        // Negative numbers become 0, too large ones the largest.
        let nanoseconds = seconds.map(|seconds| seconds.map(|s| (1e9 * s).round() as u64));
        nanoseconds.transpose()
    };
    let start = nanoseconds("start_s", start_s)?.unwrap_or(0);
    Ok(start..nanoseconds("stop_s", stop_s)?.unwrap_or(u64::MAX))
}

/// Raises what a signal's handler raises, Ctrl-C's KeyboardInterrupt above all.
fn signal_check() -> impl FnMut() -> anyhow::Result<()> {
    let mut chunks = 0;
    move || {
        chunks += 1;
        if chunks % CHUNKS_PER_CHECK == 0 {
            Python::attach(|py| py.check_signals())?;
        }
        Ok(())
    }
}

pub(crate) fn log_error(error: anyhow::Error) -> PyErr {
    match error.downcast::<PyErr>() {
        Ok(error) => error,
        Err(error) if errors::is_io(&error) => errors::from_anyhow(&error),
        Err(error) => LogError::new_err(error_message(&error)),
    }
}

fn column_arrays<'py>(
    py: Python<'py>,
    (times, columns): (Vec<u64>, Vec<Column>),
) -> PyResult<Bound<'py, PyDict>> {
    let arrays = PyDict::new(py);
    let seconds: Vec<f64> = times.iter().map(|&time| 1e-9 * time as f64).collect();
    arrays.set_item("stamp_s", seconds.into_pyarray(py))?;
    for (name, data) in columns {
        match data {
            ColumnData::F64(values) => arrays.set_item(name, values.into_pyarray(py))?,
            ColumnData::I64(values) => arrays.set_item(name, values.into_pyarray(py))?,
            ColumnData::Bool(values) => arrays.set_item(name, values.into_pyarray(py))?,
            ColumnData::Text { codes, texts } => {
                // One Python object for each different text.
                let texts = texts.iter().map(|text| PyString::new(py, text));
                let texts: Vec<Py<PyAny>> = texts.map(|text| text.into_any().unbind()).collect();
                let values = codes.iter().map(|&code| texts[code as usize].clone_ref(py));
                arrays.set_item(name, values.collect::<Vec<_>>().into_pyarray(py))?;
            }
        }
    }
    Ok(arrays)
}

fn message_object<'py>(
    py: Python<'py>,
    namespace: &Bound<'py, PyAny>,
    fields: Fields,
) -> PyResult<Bound<'py, PyAny>> {
    let attributes = PyDict::new(py);
    for (name, value) in fields {
        attributes.set_item(name, value_object(py, namespace, value)?)?;
    }
    namespace.call((), Some(&attributes))
}

fn value_object<'py>(
    py: Python<'py>,
    namespace: &Bound<'py, PyAny>,
    value: Value,
) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::Absent => py.None().into_bound(py),
        Value::Float(value) => value.into_pyobject(py)?.into_any(),
        Value::Int(value) => value.into_pyobject(py)?.into_any(),
        Value::Bool(value) => value.into_pyobject(py)?.to_owned().into_any(),
        Value::Text(text) => PyString::new(py, &text).into_any(),
        Value::Bytes(bytes) => PyBytes::new(py, &bytes).into_any(),
        Value::Floats(values) => values.into_pyarray(py).into_any(),
        Value::Ints(values) => values.into_pyarray(py).into_any(),
        Value::List(values) => {
            let values = values.into_iter();
            let objects: PyResult<Vec<_>> = values
                .map(|value| value_object(py, namespace, value))
                .collect();
            PyList::new(py, objects?)?.into_any()
        }
        Value::Message(fields) => message_object(py, namespace, fields)?,
    })
}
