//! Byte streams, split, joined, damaged or random: decoders never panic, and yield all intact messages and no others.

mod oracle;

use hw::wire::image_stream::{IMAGE_BYTES_MAX, ImageHeader};
use hw::wire::vesc::RoutedRequest;
use hw::wire::vesc_can::Addressed;
use hw::wire::{CanFrame, DecodeError, bno085, board, slcan, vesc, vesc_can, wit};
use oracle::decode_in_chunks;
use proptest::collection::vec;
use proptest::prelude::*;

fn hex(text: &str) -> Vec<u8> {
    let digits: Vec<u8> = text.bytes().filter(|digit| *digit != b' ').collect();
    digits
        .chunks(2)
        .map(|pair| u8::from_str_radix(std::str::from_utf8(pair).expect("ascii"), 16).expect("hex"))
        .collect()
}

#[test]
fn bno085_datasheet_example_round_trips() {
    let bytes = hex("AAAADE010092FF25088DFEECFFD103000000E7");
    let expected = bno085::Rvc {
        index: 0xDE,
        yaw_cdeg: 1,
        pitch_cdeg: -110,
        roll_cdeg: 2085,
        acceleration_mg: [-371, -20, 977],
    };
    assert_eq!(decode_in_chunks(bno085::decoder(), &bytes, &[]), [expected]);
    assert_eq!(expected.encode()[..], bytes);
}

#[test]
fn vesc_packets_match_the_firmware() {
    assert_eq!(vesc::Request::GetValues.encode(), hex("02 01 04 40 84 03"));
    assert_eq!(
        vesc::Request::SetRpm(1000).encode(),
        hex("02 05 08 00 00 03 E8 2B 58 03")
    );
    let forwarded = vesc::Request::SetRpm(-5).encode_forwarded(7);
    assert_eq!(forwarded[..5], hex("02 07 22 07 08"));
    assert_eq!(
        vesc::Request::decode(&forwarded),
        Some(RoutedRequest {
            node: Some(7),
            request: vesc::Request::SetRpm(-5)
        })
    );
}

#[test]
fn vesc_can_identifier_holds_command_and_node() {
    let frame = vesc_can::VescCommand::SetRpm(1000).encode(0x2A);
    assert!(frame.extended);
    assert_eq!((frame.id, frame.data()), (0x32A, &[0, 0, 3, 0xE8][..]));
    let status = CanFrame::new(0x92A, true, &[0, 0, 3, 0xE8, 0, 25, 0xFF, 0xFE]);
    assert_eq!(
        vesc_can::VescStatus::decode(&status.expect("a frame")),
        Some(Addressed {
            node: 0x2A,
            message: vesc_can::VescStatus::Motion {
                erpm: 1000,
                current_da: 25,
                duty_permille: -2
            }
        })
    );
}

#[test]
fn wit_values_use_the_protocol_scale() {
    let one_g = hex("55 51 00 00 00 00 00 08 00 00 AE");
    let messages = decode_in_chunks(wit::decoder(), &one_g, &[]);
    assert_eq!(messages[0].kind, wit::DataType::Acceleration);
    assert!((messages[0].si()[2] - 9.806_65).abs() < 1e-5);
    // 0x4000 of 0x8000 is half of 2000 °/s.
    let rate = hex("55 52 00 00 00 00 00 40 00 00 E7");
    let messages = decode_in_chunks(wit::decoder(), &rate, &[]);
    assert_eq!(messages[0].kind, wit::DataType::AngularRate);
    assert!((messages[0].si()[2] - 1000_f32.to_radians()).abs() < 1e-3);
    let angle = wit::Wit {
        kind: wit::DataType::Angle,
        raw: [0, 0, -16384, 0],
    };
    assert!((angle.si()[2] + std::f32::consts::FRAC_PI_2).abs() < 1e-6);
}

#[test]
fn slcan_lines_match_the_lawicel_format() {
    let frame = CanFrame::new(0x32A, true, &[0, 0, 3, 0xE8]).expect("a frame");
    let mut line = Vec::new();
    slcan::encode(&frame, &mut line);
    assert_eq!(line, b"T0000032A4000003E8\r");
    let input = b"T0000032A4000003e81234\r\x07z\rT0000032A4000003E\r";
    assert_eq!(
        decode_in_chunks(slcan::decoder(), input, &[]),
        [
            slcan::SlcanMessage::Frame(frame),
            slcan::SlcanMessage::Nack,
            slcan::SlcanMessage::Ack
        ]
    );
    assert_eq!(
        slcan::open_channel_commands(500_000),
        Some(b"\rC\rS6\rO\r".to_vec())
    );
    assert_eq!(slcan::open_channel_commands(300_000), None);
}

#[test]
fn base_board_messages_match_the_test_vectors() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/wire_vectors.csv");
    let table = std::fs::read_to_string(path).expect("the table");
    let mut kinds = Vec::new();
    for row in table.lines().skip(1) {
        let cells: Vec<_> = row.splitn(4, ',').collect();
        let [name, frame, sequence, fields] = cells[..] else {
            panic!("four cells: {row}");
        };
        let bytes = hex(frame);
        let packets = decode_in_chunks(board::decoder(), &bytes, &[]);
        assert_eq!(packets.len(), 1, "{name}");
        assert_eq!(packets[0].encode(), bytes, "{name}");
        let expected = format!("{name}({name} {{ {} }})", fields.trim_matches('"'));
        assert_eq!(format!("{:?}", packets[0].message), expected);
        assert_eq!(packets[0].sequence.to_string(), sequence, "{name}");
        kinds.push(packets[0].message.type_byte());
    }
    assert_eq!(
        kinds,
        [1, 2, 3, 4, 0x81, 0x82, 0x83, 0x84, 0x85, 0x86],
        "one vector for each type"
    );
}

#[test]
fn version_and_type_errors_are_reported() {
    for (frame, error) in [
        (
            "03 02 01 01 03 58 da 00",
            DecodeError::UnsupportedVersion(2),
        ),
        ("07 01 7f 01 01 9d a1 00", DecodeError::UnknownType(0x7F)),
        ("07 01 01 01 01 94 62 00", DecodeError::Length),
        ("07 01 01 01 01 94 63 00", DecodeError::Checksum),
    ] {
        let mut stream = board::decoder();
        stream.extend(&hex(frame));
        assert_eq!(stream.next(), None);
        assert_eq!(stream.stats().last_error, Some(error));
    }
}

#[test]
fn can_frames_round_trip_through_socketcan_layout() {
    let frame = CanFrame::new(0x1234_5678, true, &[1, 2, 3]).expect("a frame");
    assert_eq!(CanFrame::from_socketcan(&frame.to_socketcan()), Some(frame));
    let remote = CanFrame::remote(0x123, false, 8).expect("a frame");
    assert_eq!(
        CanFrame::from_socketcan(&remote.to_socketcan()),
        Some(remote)
    );
    let mut too_long = frame.to_socketcan();
    too_long[4] = 9;
    assert_eq!(CanFrame::from_socketcan(&too_long), None);
}

fn any_packet() -> impl Strategy<Value = board::Packet> {
    let message = prop_oneof![
        (any::<u16>(), 3u8..=4, any::<[i16; 4]>()).prop_map(|(valid_ms, wheels, speed_crad)| {
            board::WheelCommand {
                valid_ms,
                wheels,
                reserved: 0,
                speed_crad,
            }
            .into()
        }),
        any::<(u32, [u32; 4])>()
            .prop_map(|(time_us, count)| board::Encoders { time_us, count }.into()),
        any::<(u32, u16, i16, [i16; 4])>().prop_map(
            |(time_us, battery_mv, temperature_ddeg, current_ca)| board::Power {
                time_us,
                battery_mv,
                temperature_ddeg,
                current_ca
            }
            .into()
        ),
        any::<(u32, u8, u8)>().prop_map(|(time_us, bumpers, flags)| board::Switches {
            time_us,
            bumpers,
            flags
        }
        .into()),
    ];
    (any::<u16>(), message)
        .prop_map(|(sequence, message): (u16, board::Message)| board::Packet { sequence, message })
}

/// The bytes of a valid message of any protocol, with the protocol's number.
fn any_valid_message() -> impl Strategy<Value = (usize, Vec<u8>)> {
    prop_oneof![
        any_packet().prop_map(|packet| (0, packet.encode())),
        any::<(u8, [i16; 3], [i16; 3])>().prop_map(
            |(index, [yaw, pitch, roll], acceleration_mg)| {
                let message = bno085::Rvc {
                    index,
                    yaw_cdeg: yaw,
                    pitch_cdeg: pitch,
                    roll_cdeg: roll,
                    acceleration_mg,
                };
                (1, message.encode().to_vec())
            }
        ),
        (0x50u8..0x60, any::<[i16; 4]>()).prop_map(|(kind, raw)| {
            let kind = wit::DataType::Other(kind);
            (2, wit::Wit { kind, raw }.encode().to_vec())
        }),
        any::<(u8, i32, i32, u8)>().prop_map(|(node, erpm, tachometer, fault)| {
            let values = vesc::Values {
                node,
                erpm,
                tachometer,
                fault,
                ..vesc::Values::default()
            };
            (3, values.encode())
        }),
        (0u32..1 << 29, vec(any::<u8>(), 0..=8)).prop_map(|(id, data)| {
            let mut line = Vec::new();
            slcan::encode(&CanFrame::new(id, true, &data).expect("a frame"), &mut line);
            (4, line)
        }),
    ]
}

/// A stream of valid messages with noise in between and some bytes overwritten.
fn damaged_stream() -> impl Strategy<Value = Vec<u8>> {
    let piece = prop_oneof![
        4 => any_valid_message().prop_map(|(_, bytes)| bytes),
        1 => vec(any::<u8>(), 0..30),
        1 => vec(prop_oneof![Just(0xAA), Just(0x55), Just(2), Just(0), Just(3)], 0..30),
    ];
    let hits = vec((any::<prop::sample::Index>(), any::<u8>()), 0..6);
    (vec(piece, 1..12), hits).prop_map(|(pieces, hits)| {
        let mut bytes = pieces.concat();
        for (index, value) in hits {
            if !bytes.is_empty() {
                let at = index.index(bytes.len());
                bytes[at] = value;
            }
        }
        bytes
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn decoders_yield_only_messages_present_in_the_stream(
        bytes in prop_oneof![damaged_stream(), vec(any::<u8>(), 0..400)],
        cuts in vec(any::<u8>(), 0..6),
    ) {
        oracle::check_board(&bytes, &cuts);
        oracle::check_bno085(&bytes, &cuts);
        oracle::check_wit(&bytes, &cuts);
        oracle::check_vesc(&bytes, &cuts);
        oracle::check_slcan(&bytes, &cuts);
    }

    #[test]
    fn corrupted_headers_and_can_frames_are_rejected(
        noise in vec(any::<u8>(), 0..60),
        numbers in any::<[u32; 6]>(), stamp_ns in any::<i64>(), at in 0..44usize, flip in any::<u8>(),
        (exposure_us, gain_centi) in any::<(u32, i16)>(),
        id in any::<u32>(), command in prop_oneof![Just(1u32), Just(3), Just(9), Just(16), Just(27)], length in 0u8..10,
    ) {
        oracle::check_image_header(&noise);
        oracle::check_can(&noise);
        let [fourcc, width_px, height_px, stride, sequence, bytes] = numbers;
        let bytes = bytes % (2 * IMAGE_BYTES_MAX);
        let header = ImageHeader { fourcc, width_px, height_px, stride, sequence, bytes, stamp_ns, exposure_us, gain_centi };
        let mut sent = header.encode();
        prop_assert_eq!(ImageHeader::decode(&sent), (bytes <= IMAGE_BYTES_MAX).then_some(header));
        sent[at] ^= flip;
        oracle::check_image_header(&sent);
        prop_assert!(flip == 0 || ImageHeader::decode(&sent).is_none());
        let mut kernel = [0; 16];
        let id = (1 << 31) | (command << 8) | (id & 0x6000_00FF);
        kernel[..4].copy_from_slice(&id.to_ne_bytes());
        kernel[4] = length;
        kernel[8..].copy_from_slice(&stamp_ns.to_ne_bytes());
        oracle::check_can(&kernel);
    }

    #[test]
    fn decoding_is_independent_of_chunk_boundaries(bytes in damaged_stream(), cuts in vec(0u8..20, 1..6)) {
        prop_assert_eq!(decode_in_chunks(board::decoder(), &bytes, &[]), decode_in_chunks(board::decoder(), &bytes, &cuts));
        prop_assert_eq!(decode_in_chunks(bno085::decoder(), &bytes, &[]), decode_in_chunks(bno085::decoder(), &bytes, &cuts));
        prop_assert_eq!(decode_in_chunks(wit::decoder(), &bytes, &[]), decode_in_chunks(wit::decoder(), &bytes, &cuts));
        prop_assert_eq!(decode_in_chunks(vesc::decoder(), &bytes, &[]), decode_in_chunks(vesc::decoder(), &bytes, &cuts));
        prop_assert_eq!(decode_in_chunks(slcan::decoder(), &bytes, &[]), decode_in_chunks(slcan::decoder(), &bytes, &cuts));
    }

    #[test]
    fn intact_messages_are_all_decoded(sent in vec(any_packet(), 1..20), cuts in vec(0u8..20, 0..4)) {
        let bytes: Vec<u8> = sent.iter().flat_map(board::Packet::encode).collect();
        prop_assert_eq!(decode_in_chunks(board::decoder(), &bytes, &cuts), sent);
    }

    #[test]
    fn damaged_board_frame_does_not_lose_its_neighbours(
        before in any_packet(), hit in any_packet(), after in any_packet(),
        at in any::<prop::sample::Index>(), flip in 1u8..=255,
    ) {
        let mut frame = hit.encode();
        let at = at.index(frame.len() - 1);
        // A byte that becomes zero ends the frame early; the other frames must survive that too.
        frame[at] ^= flip;
        let bytes = [before.encode(), frame, after.encode()].concat();
        let packets = decode_in_chunks(board::decoder(), &bytes, &[]);
        prop_assert!(packets.first() == Some(&before) && packets.last() == Some(&after), "{:?}", packets);
        prop_assert!(!packets.contains(&hit) || hit == before || hit == after);
    }
}
