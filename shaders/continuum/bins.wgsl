// Bins of the continuum whose fragments are added up or averaged.

// the bin at hand: its fragments, and their absorbance
var<private> bin_sums: Sums;
var<private> bin_absorbance: f32;
// absorbance of the bins in front of it
var<private> tau: f32;

fn end_bin() {
    if params.merge == SUM {
        tau += bin_absorbance;
        core.y = seen_through(tau);
    } else {
        // FEE21 eq. 4
        if bin_sums.weighted.a > 0.0 {
            core_color += core.y * bin_sums.coverage * average_of(bin_sums.weighted);
            core.x += core.y * bin_sums.coverage;
        }
        core.y *= bin_sums.transmittance;
    }
    bin_sums = NO_SUMS;
    bin_absorbance = 0.0;
}

fn put_into_bin(place: u32) {
    let fragment = as_stored(colors[place]);
    if params.merge == SUM {
        bin_absorbance += absorbance_of(fragment.a, params.s_max);
    } else {
        let weight = weight_of(params.weight, depth_in(keys[place]), fragment.a);
        bin_sums = with_fragment(bin_sums, weight, fragment);
    }
}

@compute @workgroup_size(8, 8)
fn resolve_bins(@builtin(global_invocation_id) id: vec3u) {
    if is_outside(id) {
        return;
    }
    let list = begin_pixel(id);
    sort_out(list);
    begin_core();
    bin_sums = NO_SUMS;
    bin_absorbance = 0.0;
    tau = 0.0;
    var bin = 0u;
    let end = list.x + list.y;
    var stored = list.x;
    let lost_first = list.x + count_stored(list);
    var lost = lost_first;
    while stored < lost_first || lost < end {
        let is_stored = lost == end || (stored < lost_first && comes_before_by_depth(keys[stored], unmarked_key(lost)));
        let place = select(lost, stored, is_stored);
        let own = bin_of(unmarked_key(place));
        if own != bin {
            end_bin();
            bin = own;
        }
        add_fragment(colors[place], depth_in(unmarked_key(place)), core.y, is_stored);
        if is_stored {
            put_into_bin(place);
            stored++;
        } else {
            lost++;
        }
    }
    end_bin();
    store_core(id, false);
}
