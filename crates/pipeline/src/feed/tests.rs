//! Tests of the feed: delivery, drops and closing.

use std::sync::Arc;
use std::time::Duration;

use super::{DropCounts, Feed, RecvError};
use crate::testing::random_cycle;

#[test]
fn every_subscriber_gets_every_cycle_from_its_subscription_on() {
    let feed = Feed::new();
    let early = feed.subscribe(8);
    feed.publish(&Arc::new(random_cycle(0)));
    let late = feed.subscribe(8);
    feed.publish(&Arc::new(random_cycle(1)));
    let stamps = |subscription: &super::Subscription| {
        std::iter::from_fn(|| subscription.try_recv().ok())
            .map(|cycle| cycle.stamp)
            .collect::<Vec<_>>()
    };
    assert_eq!(
        stamps(&early),
        [random_cycle(0).stamp, random_cycle(1).stamp]
    );
    assert_eq!(stamps(&late), [random_cycle(1).stamp]);
    assert_eq!(early.try_recv().err(), Some(RecvError::Timeout));
    drop(feed);
    assert_eq!(
        early.recv_timeout(Duration::from_secs(60)).err(),
        Some(RecvError::Closed)
    );
}

#[test]
fn slow_subscriber_loses_oldest_images_first_and_sees_the_drop_counts() {
    let feed = Feed::new();
    let slow = feed.subscribe(4);
    let newest = feed.subscribe(1);
    for number in 0..6 {
        feed.publish(&Arc::new(random_cycle(number)));
    }
    let received: Vec<_> = std::iter::from_fn(|| slow.try_recv().ok())
        .map(|cycle| (cycle.stamp, cycle.inputs.image.is_some()))
        .collect();
    let expected = [(2, false), (3, false), (4, false), (5, true)];
    assert_eq!(
        received,
        expected.map(|(number, image)| (random_cycle(number).stamp, image))
    );
    assert_eq!(
        slow.dropped(),
        DropCounts {
            images: 5,
            cycles: 2
        }
    );
    let last = newest.try_recv().expect("the newest");
    assert_eq!(last.stamp, random_cycle(5).stamp);
    assert!(last.inputs.image.is_some());
}

#[test]
fn dropped_subscription_is_removed() {
    let feed = Feed::new();
    drop(feed.subscribe(2));
    let cycle = Arc::new(random_cycle(0));
    feed.publish(&cycle);
    assert_eq!(Arc::strong_count(&cycle), 1);
}
