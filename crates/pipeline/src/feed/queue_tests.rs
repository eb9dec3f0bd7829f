//! Tests of the queue with a slow consumer: blocking and drops.

use std::sync::Arc;

use super::queue::{CycleQueue, DropCounts};
use crate::feed::Pace;
use crate::testing::random_cycle;

#[test]
fn a_full_live_queue_drops_images_before_cycles_and_counts_them() {
    let queue = CycleQueue::new(Pace::Live, 2, 4);
    for number in 0..6 {
        queue.push((number, Arc::new(random_cycle(number))));
    }
    queue.close();
    let mut found = Vec::new();
    let mut dropped = DropCounts::default();
    while let Some(((number, cycle), lost)) = queue.pop() {
        found.push((number, cycle.inputs.image.is_some()));
        dropped.images += lost.images;
        dropped.cycles += lost.cycles;
    }
    assert_eq!(found, [(2, false), (3, false), (4, true), (5, true)]);
    assert_eq!((dropped.images, dropped.cycles), (4, 2));
}

#[test]
fn a_lockstep_queue_waits_and_drops_nothing() {
    let queue = CycleQueue::new(Pace::Lockstep, 1, 2);
    let popped = std::thread::scope(|scope| {
        let reader = scope.spawn(|| {
            std::iter::from_fn(|| queue.pop())
                .map(|(_, lost)| u64::from(lost.is_zero()))
                .sum::<u64>()
        });
        (0..50).for_each(|number| queue.push((number, Arc::new(random_cycle(number)))));
        queue.close();
        reader.join().expect("joined")
    });
    assert_eq!(popped, 50);
}
