//! Recordings that other programs wrote: what they hold is read, or named by topic and encoding.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use mcap::{Compression, WriteOptions, Writer};
use stiction_files::load_samples;

use crate::common::program::{expect, stderr, stdout};

/// Messages of a channel.
const EACH: u64 = 40;

/// A recording with these channels: topic, encoding of its messages, name and encoding of its schema, and a payload.
type Channels<'c> = [(&'c str, &'c str, (&'c str, &'c str), &'c [u8])];

fn written(folder: &Path, options: WriteOptions, channels: &Channels<'_>) -> PathBuf {
    let path = folder.join("a.mcap");
    let mut writer: Writer<_> = options.create(fs::File::create(&path).unwrap()).unwrap();
    for (topic, encoding, (name, of_schema), payload) in channels {
        let schema = if of_schema.is_empty() { 0 } else { writer.add_schema(name, of_schema, b"x").unwrap() };
        let channel_id = writer.add_channel(schema, topic, encoding, &BTreeMap::new()).unwrap();
        for k in 0..EACH {
            let time = 1_767_600_000_000_000_000 + k * 1_000_000_000;
            let header = MessageHeader { channel_id, sequence: k as u32, log_time: time, publish_time: time };
            writer.write_to_known_channel(&header, payload).unwrap();
        }
        writer.flush().unwrap();
    }
    writer.finish().unwrap();
    path
}

#[test]
fn encodings_that_are_not_read_are_named_with_their_topic() {
    let folder = tempfile::tempdir().unwrap();
    let double = 42.5_f64.to_le_bytes();
    let cdr = [&[0, 1, 0, 0][..], &double].concat();
    let proto = [&[9][..], &double].concat();
    for (encoding, schema, payload, named) in [
        ("cdr", ("std_msgs/msg/Float64", "ros2msg"), &cdr[..], "cdr"),
        ("ros1", ("std_msgs/Float64", "ros1msg"), &double, "ros1"),
        ("protobuf", ("foxglove.Value", "protobuf"), &proto, "protobuf"),
        ("", ("std_msgs/Float64", "ros1msg"), &double, "ros1msg"),
        ("", ("", "omgidl"), &double, "omgidl"),
        ("msgpack", ("", ""), &[0xcb, 64, 69, 64, 0, 0, 0, 0], "msgpack"),
    ] {
        let channels = ["p/FIC101/op", "p/FIC101/pv"].map(|topic| (topic, encoding, schema, payload));
        let path = written(folder.path(), WriteOptions::new(), &channels);
        for command in ["info", "analyze"] {
            let told = stderr(&expect(1, &[command, path.to_str().unwrap()]));
            assert!(told.contains("p/FIC101/op") && told.contains(&format!("{named:?}")), "{encoding}: {told}");
        }
    }
    let channels = [("/camera", "cdr", ("sensor_msgs/msg/Image", "ros2msg"), &cdr[..])];
    let path = written(folder.path(), WriteOptions::new(), &channels);
    for command in ["info", "analyze"] {
        let told = stderr(&expect(1, &[command, path.to_str().unwrap()]));
        assert!(told.contains("/camera") && told.contains("\"cdr\""), "{told}");
    }
}

#[test]
fn json_is_read_however_its_file_is_built() {
    let folder = tempfile::tempdir().unwrap();
    let new = WriteOptions::new;
    let bare = new().emit_summary_records(false).emit_summary_offsets(false).emit_statistics(false);
    for (what, options) in [
        ("no chunks", new().use_chunks(false)),
        ("lz4", new().compression(Some(Compression::Lz4))),
        ("zstd", new().compression(Some(Compression::Zstd))),
        ("no compression", new().compression(None)),
        ("no summary", bare.emit_message_indexes(false).emit_chunk_indexes(false)),
        ("no checksums", new().calculate_chunk_crcs(false).calculate_data_section_crc(false)),
    ] {
        for (encoding, schema) in [("json", ("", "")), ("json", ("", "jsonschema")), ("", ("x", "jsonschema"))] {
            let channels = ["p/FIC101/op", "p/FIC101/pv"].map(|topic| (topic, encoding, schema, &b"{\"v\": 42.5}"[..]));
            let path = written(folder.path(), options.clone(), &channels);
            let text = stdout(&expect(0, &["info", path.to_str().unwrap()]));
            assert!(text.contains("clean") && text.contains("op 40, pv 40"), "{what}: {text}");
        }
    }
}

#[test]
fn a_chunk_with_a_wrong_checksum_is_left_out_and_said() {
    let folder = tempfile::tempdir().unwrap();
    for compression in [None, Some(Compression::Lz4), Some(Compression::Zstd)] {
        let channels = ["p/FIC101/op", "p/FIC101/pv"].map(|topic| (topic, "json", ("", ""), &b"{\"v\": 42.5}"[..]));
        let path = written(folder.path(), WriteOptions::new().compression(compression), &channels);
        let mut bytes = fs::read(&path).unwrap();
        // The checksum of the first chunk: behind its head of 8 + 8 + 8 bytes.
        let header = 8 + 9 + u64::from_le_bytes(bytes[9..17].try_into().unwrap()) as usize;
        assert_eq!(bytes[header], mcap::records::op::CHUNK);
        bytes[header + 9 + 24] ^= 1;
        fs::write(&path, &bytes).unwrap();
        let loaded = load_samples(&path).unwrap();
        let one = &loaded.loops[0];
        assert!(loaded.data_loss && one.samples.len() == EACH as usize, "{compression:?}: {}", one.samples.len());
        let told = stderr(&expect(3, &["info", path.to_str().unwrap()]));
        assert!(told.contains("damaged chunk"), "{told}");
    }
}
