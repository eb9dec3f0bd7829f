/* Prints the calls, offsets and constants of linux/videodev2.h that the camera driver uses. */
#include <stddef.h>
#include <stdio.h>
#include <linux/videodev2.h>

#define CALL(name, number, type) printf("%s %#lx %zu\n", name, (unsigned long)(number), sizeof(type))
#define OFFSET(name, type, field) printf("%s %zu\n", name, offsetof(type, field))
#define CONSTANT(value) printf("%#lx\n", (unsigned long)(value) & 0xFFFFFFFFul)

int main(void)
{
    CALL("query_capability", VIDIOC_QUERYCAP, struct v4l2_capability);
    CALL("enumerate_formats", VIDIOC_ENUM_FMT, struct v4l2_fmtdesc);
    CALL("set_format", VIDIOC_S_FMT, struct v4l2_format);
    CALL("request_buffers", VIDIOC_REQBUFS, struct v4l2_requestbuffers);
    CALL("query_buffer", VIDIOC_QUERYBUF, struct v4l2_buffer);
    CALL("queue", VIDIOC_QBUF, struct v4l2_buffer);
    CALL("dequeue", VIDIOC_DQBUF, struct v4l2_buffer);
    CALL("stream_on", VIDIOC_STREAMON, int);
    CALL("stream_off", VIDIOC_STREAMOFF, int);
    CALL("set_parameters", VIDIOC_S_PARM, struct v4l2_streamparm);
    CALL("get_control", VIDIOC_G_CTRL, struct v4l2_control);
    CALL("set_control", VIDIOC_S_CTRL, struct v4l2_control);
    CALL("query_control", VIDIOC_QUERYCTRL, struct v4l2_queryctrl);
    OFFSET("capability.device_caps", struct v4l2_capability, device_caps);
    OFFSET("format.width", struct v4l2_format, fmt.pix.width);
    OFFSET("format.bytes_per_line", struct v4l2_format, fmt.pix.bytesperline);
    OFFSET("format.size_image", struct v4l2_format, fmt.pix.sizeimage);
    OFFSET("parameters.period", struct v4l2_streamparm, parm.capture.timeperframe);
    OFFSET("description.fourcc", struct v4l2_fmtdesc, pixelformat);
    OFFSET("buffer.flags", struct v4l2_buffer, flags);
    OFFSET("buffer.seconds", struct v4l2_buffer, timestamp.tv_sec);
    OFFSET("buffer.microseconds", struct v4l2_buffer, timestamp.tv_usec);
    OFFSET("buffer.sequence", struct v4l2_buffer, sequence);
    OFFSET("buffer.memory", struct v4l2_buffer, memory);
    OFFSET("buffer.offset", struct v4l2_buffer, m.offset);
    OFFSET("buffer.length", struct v4l2_buffer, length);
    OFFSET("range.minimum", struct v4l2_queryctrl, minimum);
    OFFSET("range.step", struct v4l2_queryctrl, step);
    OFFSET("range.flags", struct v4l2_queryctrl, flags);
    CONSTANT(V4L2_BUF_TYPE_VIDEO_CAPTURE);
    CONSTANT(V4L2_MEMORY_MMAP);
    CONSTANT(V4L2_CAP_VIDEO_CAPTURE);
    CONSTANT(V4L2_CAP_STREAMING);
    CONSTANT(V4L2_CAP_DEVICE_CAPS);
    CONSTANT(V4L2_BUF_FLAG_ERROR);
    CONSTANT(V4L2_BUF_FLAG_TIMESTAMP_MASK);
    CONSTANT(V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC);
    CONSTANT(V4L2_CTRL_FLAG_DISABLED);
    CONSTANT(V4L2_CTRL_FLAG_READ_ONLY);
    CONSTANT(V4L2_CID_EXPOSURE_AUTO);
    CONSTANT(V4L2_CID_EXPOSURE_AUTO_PRIORITY);
    CONSTANT(V4L2_CID_EXPOSURE_ABSOLUTE);
    CONSTANT(V4L2_CID_AUTOGAIN);
    CONSTANT(V4L2_CID_GAIN);
    CONSTANT(V4L2_CID_AUTO_WHITE_BALANCE);
    CONSTANT(V4L2_CID_WHITE_BALANCE_TEMPERATURE);
    return 0;
}
