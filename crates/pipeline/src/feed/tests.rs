//! Claims about the feed: who gets what, and who waits for whom.

use std::sync::Arc;
use std::time::Duration;

use super::{Dropped, Feed, Nothing};
use crate::testing::cycle;

#[test]
fn every_subscriber_gets_every_cycle_from_its_subscription_on() {
    let feed = Feed::new();
    let early = feed.subscribe(8);
    feed.publish(&Arc::new(cycle(0)));
    let late = feed.subscribe(8);
    feed.publish(&Arc::new(cycle(1)));
    let stamps = |subscription: &super::Subscription| {
        std::iter::from_fn(|| subscription.try_recv().ok())
            .map(|cycle| cycle.stamp)
            .collect::<Vec<_>>()
    };
    assert_eq!(stamps(&early), [cycle(0).stamp, cycle(1).stamp]);
    assert_eq!(stamps(&late), [cycle(1).stamp]);
    assert_eq!(early.try_recv().err(), Some(Nothing::Yet));
    drop(feed);
    assert_eq!(
        early.recv_timeout(Duration::from_secs(60)).err(),
        Some(Nothing::Ever)
    );
}

#[test]
fn who_is_behind_loses_the_oldest_and_images_first_and_is_told() {
    let feed = Feed::new();
    let slow = feed.subscribe(4);
    let newest = feed.subscribe(1);
    for number in 0..6 {
        feed.publish(&Arc::new(cycle(number)));
    }
    let got: Vec<_> = std::iter::from_fn(|| slow.try_recv().ok())
        .map(|cycle| (cycle.stamp, cycle.inputs.image.is_some()))
        .collect();
    let wanted = [(2, false), (3, false), (4, false), (5, true)];
    assert_eq!(
        got,
        wanted.map(|(number, image)| (cycle(number).stamp, image))
    );
    assert_eq!(
        slow.dropped(),
        Dropped {
            images: 5,
            cycles: 2
        }
    );
    let last = newest.try_recv().expect("the newest");
    assert_eq!(last.stamp, cycle(5).stamp);
    assert!(last.inputs.image.is_some());
}

#[test]
fn a_subscriber_that_left_is_forgotten() {
    let feed = Feed::new();
    drop(feed.subscribe(2));
    let cycle = Arc::new(cycle(0));
    feed.publish(&cycle);
    assert_eq!(Arc::strong_count(&cycle), 1);
}
