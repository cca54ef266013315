// A node of ROS 2's default middleware, without ROS: eProsima Fast DDS, used as rmw_fastrtps does.
//
//   node DOMAIN DISCOVERY GID_LENGTH NODE [COMMAND...]
//
// DISCOVERY: default, whitelist (ROS_LOCALHOST_ONLY=1 of Humble), or unicast
// (ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST from Iron on). GID_LENGTH: 24 of Humble, 16 after it.
// Each COMMAND, and after them each line of standard input, is one of
//
//   subscribe TOPIC TYPE RELIABILITY DURABILITY DEPTH [TYPEHASH]
//   advertise TOPIC TYPE RELIABILITY DURABILITY DEPTH [TYPEHASH]
//   publish TOPIC CDR [COUNT PERIOD_MS]
//   client SERVICE TYPE
//   request SERVICE CDR
//   server SERVICE TYPE CDR_OF_REPLY
//
// with names as ROS has them (/state/pose, geometry_msgs/msg/PoseStamped), RELIABILITY reliable or
// best_effort, DURABILITY volatile or transient_local, and CDR in hex with its encapsulation. It
// ends with its standard input. What it meets and hears is told as lines of JSON.
//
// Source: rmw_fastrtps_shared_cpp (names, user_data, QoS, sample identities of services,
// ros_discovery_info); no code of it.

#include <atomic>
#include <cctype>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <iostream>
#include <map>
#include <memory>
#include <mutex>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/domain/DomainParticipantListener.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/DataWriterListener.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastdds/rtps/transport/shared_mem/SharedMemTransportDescriptor.h>

namespace fast = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
using Bytes = std::vector<uint8_t>;

constexpr uint32_t PEERS = 32;  // Participants of one computer that unicast discovery asks for.

// -- words ----------------------------------------------------------------------------------------

std::string hex(const void* data, size_t size)
{
    static const char digits[] = "0123456789abcdef";
    std::string text;
    for (size_t i = 0; i < size; ++i) {
        const uint8_t byte = static_cast<const uint8_t*>(data)[i];
        text += digits[byte >> 4];
        text += digits[byte & 15];
    }
    return text;
}

Bytes unhex(const std::string& text)
{
    Bytes bytes;
    if (text.size() % 2 != 0) throw std::runtime_error("an odd number of hex digits");
    for (size_t i = 0; i < text.size(); i += 2)
        bytes.push_back(static_cast<uint8_t>(std::stoi(text.substr(i, 2), nullptr, 16)));
    return bytes;
}

Bytes guid_bytes(const rtps::GUID_t& guid)
{
    Bytes bytes(guid.guidPrefix.value, guid.guidPrefix.value + 12);
    bytes.insert(bytes.end(), guid.entityId.value, guid.entityId.value + 4);
    return bytes;
}

std::string guid_text(const rtps::GUID_t& guid)
{
    const Bytes bytes = guid_bytes(guid);
    return hex(bytes.data(), bytes.size());
}

std::string quoted(const std::string& text)
{
    std::string out = "\"";
    for (const char c : text) {
        if (c == '"' || c == '\\') out += '\\';
        if (static_cast<unsigned char>(c) < 0x20) continue;
        out += c;
    }
    return out + '"';
}

// geometry_msgs/msg/PoseStamped -> geometry_msgs::msg::dds_::PoseStamped_
std::string dds_type(const std::string& type)
{
    const size_t first = type.find('/'), last = type.rfind('/');
    if (first == std::string::npos || first == last)
        throw std::runtime_error(type + ": a type is PACKAGE/msg/NAME or PACKAGE/srv/NAME");
    return type.substr(0, first) + "::" + type.substr(first + 1, last - first - 1) + "::dds_::"
        + type.substr(last + 1) + "_";
}

class Event {
public:
    explicit Event(const std::string& name) { text_ = "{\"event\": " + quoted(name); }
    Event& add(const std::string& key, const std::string& value)
    {
        text_ += ", \"" + key + "\": " + quoted(value);
        return *this;
    }
    Event& number(const std::string& key, long long value)
    {
        text_ += ", \"" + key + "\": " + std::to_string(value);
        return *this;
    }
    void tell()
    {
        static std::mutex telling;
        const std::lock_guard<std::mutex> lock(telling);
        std::cout << text_ << "}" << std::endl;
    }

private:
    std::string text_;
};

// -- the type: bytes of CDR, passed on as they are ------------------------------------------------

class RawType : public fast::TopicDataType {
public:
    explicit RawType(const std::string& name)
    {
        setName(name.c_str());
        m_typeSize = 1024;  // Where more comes, memory is made anew: PREALLOCATED_WITH_REALLOC.
        m_isGetKeyDefined = false;
        auto_fill_type_object(false);
        auto_fill_type_information(false);
    }
    bool serialize(void* data, rtps::SerializedPayload_t* payload) override
    {
        const Bytes& bytes = *static_cast<Bytes*>(data);
        if (bytes.size() > payload->max_size) return false;
        std::memcpy(payload->data, bytes.data(), bytes.size());
        payload->length = static_cast<uint32_t>(bytes.size());
        payload->encapsulation = CDR_LE;
        return true;
    }
    bool deserialize(rtps::SerializedPayload_t* payload, void* data) override
    {
        static_cast<Bytes*>(data)->assign(payload->data, payload->data + payload->length);
        return true;
    }
    std::function<uint32_t()> getSerializedSizeProvider(void* data) override
    {
        return [data] { return static_cast<uint32_t>(static_cast<Bytes*>(data)->size()); };
    }
    void* createData() override { return new Bytes; }
    void deleteData(void* data) override { delete static_cast<Bytes*>(data); }
    bool getKey(void*, rtps::InstanceHandle_t*, bool) override { return false; }
    bool is_bounded() const override { return false; }
};

// -- endpoints ------------------------------------------------------------------------------------

struct Quality {
    bool reliable = true, latched = false;
    int32_t depth = 10;
};

template<class Qos>
void apply(Qos& qos, const Quality& quality, const std::string& hash)
{
    qos.reliability().kind =
        quality.reliable ? fast::RELIABLE_RELIABILITY_QOS : fast::BEST_EFFORT_RELIABILITY_QOS;
    qos.durability().kind =
        quality.latched ? fast::TRANSIENT_LOCAL_DURABILITY_QOS : fast::VOLATILE_DURABILITY_QOS;
    qos.history().kind =
        quality.depth > 0 ? fast::KEEP_LAST_HISTORY_QOS : fast::KEEP_ALL_HISTORY_QOS;
    if (quality.depth > 0) qos.history().depth = quality.depth;
    qos.resource_limits().max_samples = 0;  // No bound but the history's.
    qos.resource_limits().max_instances = 0;
    qos.resource_limits().max_samples_per_instance = 0;
    qos.resource_limits().allocated_samples = 0;
    qos.endpoint().history_memory_policy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    qos.data_sharing().off();
    if (!hash.empty()) {
        const std::string words = "typehash=" + hash + ";";
        qos.user_data().data_vec({words.begin(), words.end()});
    }
}

class Writer : public fast::DataWriterListener {
public:
    void on_publication_matched(
        fast::DataWriter*, const fast::PublicationMatchedStatus& status) override
    {
        matched = status.current_count;
        Event("matched").add("topic", name).add("kind", "writer").number(
            "count", status.current_count).tell();
    }
    std::string name;
    fast::DataWriter* writer = nullptr;
    std::atomic<int> matched{0};
};

class Reader : public fast::DataReaderListener {
public:
    using Heard = std::function<void(const Bytes&, const fast::SampleInfo&)>;

    void on_subscription_matched(
        fast::DataReader*, const fast::SubscriptionMatchedStatus& status) override
    {
        Event("matched").add("topic", name).add("kind", "reader").number(
            "count", status.current_count).tell();
    }
    void on_data_available(fast::DataReader* from) override
    {
        Bytes bytes;
        fast::SampleInfo info;
        while (from->take_next_sample(&bytes, &info) == ReturnCode_t::RETCODE_OK)
            if (info.valid_data) heard(bytes, info);
    }
    std::string name;
    fast::DataReader* reader = nullptr;
    Heard heard;
};

// -- the node -------------------------------------------------------------------------------------

class Node : public fast::DomainParticipantListener {
public:
    Node(uint32_t domain, const std::string& discovery, size_t gid_length, const std::string& name)
        : gid_length_(gid_length), name_(name)
    {
        auto* factory = fast::DomainParticipantFactory::get_instance();
        fast::DomainParticipantQos qos = fast::PARTICIPANT_QOS_DEFAULT;
        const std::string enclave = "enclave=/;";
        qos.name("/");
        qos.user_data().data_vec({enclave.begin(), enclave.end()});
        qos.wire_protocol().builtin.readerHistoryMemoryPolicy =
            qos.wire_protocol().builtin.writerHistoryMemoryPolicy =
                rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
        find_by(discovery, qos);
        participant_ = factory->create_participant(domain, qos, this, fast::StatusMask::none());
        if (participant_ == nullptr) throw std::runtime_error("there is no participant");
        publisher_ = participant_->create_publisher(fast::PUBLISHER_QOS_DEFAULT);
        subscriber_ = participant_->create_subscriber(fast::SUBSCRIBER_QOS_DEFAULT);
        Event("participant").add("guid", guid_text(participant_->guid())).number(
            "domain", domain).tell();
        const std::string info = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_";
        reader("ros_discovery_info", info, {true, true, 0}, "", [](const Bytes& cdr, const auto&) {
            Event("graph").add("cdr", hex(cdr.data(), cdr.size())).tell();
        });
        graph_ = writer("ros_discovery_info", info, {true, true, 1}, "");
        named_readers_.clear();
        named_writers_.clear();
        announce();
    }

    ~Node() override
    {
        over_ = true;
        for (auto& each : publishing_) each.join();
        name_.clear();
        announce();
        participant_->delete_contained_entities();
        fast::DomainParticipantFactory::get_instance()->delete_participant(participant_);
    }

    void on_participant_discovery(
        fast::DomainParticipant*, rtps::ParticipantDiscoveryInfo&& found) override
    {
        const auto& user = found.info.m_userData;
        static const char* const words[] = {"found", "changed", "removed", "dropped", "ignored"};
        Event("participant_seen")
            .add("guid", guid_text(found.info.m_guid))
            .add("what", found.status <= 4 ? words[found.status] : "")
            .add("user_data", {user.begin(), user.end()})
            .tell();
    }

    void on_publisher_discovery(
        fast::DomainParticipant* of, rtps::WriterDiscoveryInfo&& found) override
    {
        tell(*of, "writer", found.info, found.status == rtps::WriterDiscoveryInfo::REMOVED_WRITER);
    }

    void on_subscriber_discovery(
        fast::DomainParticipant* of, rtps::ReaderDiscoveryInfo&& found) override
    {
        tell(*of, "reader", found.info, found.status == rtps::ReaderDiscoveryInfo::REMOVED_READER);
    }

    // Carry out one command.
    void obey(const std::string& line)
    {
        std::istringstream words(line);
        std::string verb, name;
        if (!(words >> verb)) return;
        if (!(words >> name)) throw std::runtime_error(verb + ": of what?");
        if (verb == "subscribe" || verb == "advertise") {
            std::string type, reliability, durability, hash;
            Quality quality;
            if (!(words >> type >> reliability >> durability >> quality.depth))
                throw std::runtime_error(verb + ": TYPE RELIABILITY DURABILITY DEPTH are missing");
            words >> hash;
            quality.reliable = reliability == "reliable";
            quality.latched = durability == "transient_local";
            if (verb == "advertise") {
                topics_[name] = writer("rt" + name, dds_type(type), quality, hash);
            } else {
                reader("rt" + name, dds_type(type), quality, hash,
                    [name](const Bytes& cdr, const fast::SampleInfo& info) {
                        Event("sample").add("topic", name)
                            .add("writer", guid_text(info.sample_identity.writer_guid()))
                            .add("cdr", hex(cdr.data(), cdr.size())).tell();
                    });
            }
            announce();
        } else if (verb == "publish") {
            publish(name, words);
        } else if (verb == "client") {
            std::string type;
            words >> type;
            client(name, type);
            announce();
        } else if (verb == "request") {
            std::string cdr;
            words >> cdr;
            request(name, unhex(cdr));
        } else if (verb == "server") {
            std::string type, reply;
            words >> type >> reply;
            server(name, type, unhex(reply));
            announce();
        } else {
            throw std::runtime_error(verb + ": no such command");
        }
    }

private:
    struct Client {
        std::shared_ptr<Writer> requests;
        std::shared_ptr<Reader> replies;
    };

    static void find_by(const std::string& discovery, fast::DomainParticipantQos& qos)
    {
        if (discovery == "default") return;
        qos.transport().use_builtin_transports = false;
        auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
        qos.transport().user_transports.push_back(udp);
        qos.transport().user_transports.push_back(
            std::make_shared<eprosima::fastdds::rtps::SharedMemTransportDescriptor>());
        if (discovery == "whitelist") {
            udp->interfaceWhiteList.emplace_back("127.0.0.1");
        } else if (discovery == "unicast") {
            udp->maxInitialPeersRange = PEERS;
            rtps::BuiltinAttributes& builtin = qos.wire_protocol().builtin;
            rtps::Locator_t any, peer;
            builtin.metatrafficMulticastLocatorList.clear();
            builtin.metatrafficUnicastLocatorList.push_back(any);
            rtps::IPLocator::setIPv4(peer, 127, 0, 0, 1);
            builtin.initialPeersList.push_back(peer);
        } else {
            throw std::runtime_error(discovery + ": no such discovery");
        }
    }

    fast::Topic* topic(const std::string& name, const std::string& type)
    {
        if (auto* known = participant_->lookup_topicdescription(name))
            return dynamic_cast<fast::Topic*>(known);
        fast::TypeSupport(new RawType(type)).register_type(participant_);
        fast::Topic* made = participant_->create_topic(name, type, fast::TOPIC_QOS_DEFAULT);
        if (made == nullptr) throw std::runtime_error("there is no topic " + name);
        return made;
    }

    std::shared_ptr<Writer> writer(
        const std::string& name, const std::string& type, const Quality& quality,
        const std::string& hash)
    {
        auto made = std::make_shared<Writer>();
        made->name = name;
        fast::DataWriterQos qos = fast::DATAWRITER_QOS_DEFAULT;
        apply(qos, quality, hash);
        qos.writer_data_lifecycle().autodispose_unregistered_instances = false;
        qos.publish_mode().kind = fast::SYNCHRONOUS_PUBLISH_MODE;
        made->writer = publisher_->create_datawriter(topic(name, type), qos, made.get());
        if (made->writer == nullptr) throw std::runtime_error("there is no writer of " + name);
        writers_.push_back(made);
        named_writers_.push_back(made->writer->guid());
        Event("made").add("kind", "writer").add("topic", name).add(
            "guid", guid_text(made->writer->guid())).tell();
        return made;
    }

    std::shared_ptr<Reader> reader(
        const std::string& name, const std::string& type, const Quality& quality,
        const std::string& hash, Reader::Heard heard)
    {
        auto made = std::make_shared<Reader>();
        made->name = name;
        made->heard = std::move(heard);
        fast::DataReaderQos qos = fast::DATAREADER_QOS_DEFAULT;
        apply(qos, quality, hash);
        made->reader = subscriber_->create_datareader(topic(name, type), qos, made.get());
        if (made->reader == nullptr) throw std::runtime_error("there is no reader of " + name);
        readers_.push_back(made);
        named_readers_.push_back(made->reader->guid());
        Event("made").add("kind", "reader").add("topic", name).add(
            "guid", guid_text(made->reader->guid())).tell();
        return made;
    }

    void publish(const std::string& name, std::istringstream& words)
    {
        const auto found = topics_.find(name);
        if (found == topics_.end()) throw std::runtime_error(name + ": advertise it first");
        std::string text;
        long count = 1, period_ms = 0;
        words >> text >> count >> period_ms;
        auto cdr = std::make_shared<Bytes>(unhex(text));
        const auto to = found->second;
        publishing_.emplace_back([this, to, cdr, count, period_ms, name] {
            auto due = std::chrono::steady_clock::now();
            long done = 0;
            for (; done < count && !over_; ++done) {
                if (!to->writer->write(cdr.get())) break;
                due += std::chrono::milliseconds(period_ms);
                std::this_thread::sleep_until(due);
            }
            Event("published").add("topic", name).number("count", done).tell();
        });
    }

    void client(const std::string& name, const std::string& type)
    {
        Client made;
        made.replies = reader("rr" + name + "Reply", dds_type(type + "_Response"), {}, "",
            [name](const Bytes& cdr, const fast::SampleInfo& info) {
                Event("reply").add("service", name)
                    .number("sequence", info.related_sample_identity.sequence_number().to64long())
                    .add("cdr", hex(cdr.data(), cdr.size())).tell();
            });
        made.requests = writer("rq" + name + "Request", dds_type(type + "_Request"), {}, "");
        clients_[name] = made;
    }

    void request(const std::string& name, Bytes cdr)
    {
        const auto found = clients_.find(name);
        if (found == clients_.end()) throw std::runtime_error(name + ": make a client first");
        rtps::WriteParams identity;
        identity.related_sample_identity().writer_guid(found->second.replies->reader->guid());
        const bool written = found->second.requests->writer->write(&cdr, identity);
        Event("requested").add("service", name).number("written", written)
            .number("servers", found->second.requests->matched)
            .number("sequence", identity.sample_identity().sequence_number().to64long()).tell();
    }

    void server(const std::string& name, const std::string& type, const Bytes& reply)
    {
        auto replies = writer("rr" + name + "Reply", dds_type(type + "_Response"), {}, "");
        reader("rq" + name + "Request", dds_type(type + "_Request"), {}, "",
            [name, reply, replies](const Bytes& cdr, const fast::SampleInfo& info) {
                Event("request").add("service", name).add("cdr", hex(cdr.data(), cdr.size()))
                    .add("writer", guid_text(info.sample_identity.writer_guid())).tell();
                rtps::WriteParams identity;
                identity.related_sample_identity() = info.sample_identity;
                const auto& reader = info.related_sample_identity.writer_guid();
                if (reader != rtps::GUID_t::unknown())
                    identity.related_sample_identity().writer_guid(reader);
                Bytes answer = reply;
                replies->writer->write(&answer, identity);
            });
    }

    template<class Found>
    static void tell(
        const fast::DomainParticipant& of, const std::string& kind, const Found& found, bool gone)
    {
        if (found.guid().guidPrefix == of.guid().guidPrefix) return;
        const auto& user = found.m_qos.m_userData;
        Event(gone ? "endpoint_gone" : "endpoint_seen")
            .add("kind", kind)
            .add("topic", found.topicName().to_string())
            .add("type", found.typeName().to_string())
            .add("guid", guid_text(found.guid()))
            .add("user_data", {user.begin(), user.end()})
            .add("reliability", found.m_qos.m_reliability.kind == fast::RELIABLE_RELIABILITY_QOS
                    ? "reliable" : "best_effort")
            .add("durability",
                found.m_qos.m_durability.kind == fast::TRANSIENT_LOCAL_DURABILITY_QOS
                    ? "transient_local" : "volatile")
            .number("representations", representations(found.m_qos))
            .tell();
    }

    // Bits of the data representations that are offered: 1 XCDR1, 2 XML, 4 XCDR2; 0 none, which
    // means XCDR1.
    template<class Qos> static long long representations(const Qos& qos)
    {
        long long bits = 0;
        for (const auto each : qos.representation.m_value) bits |= 1LL << each;
        return bits;
    }

    // A full snapshot of the participant's one node, as CDR.
    void announce()
    {
        Bytes cdr{0, 1, 0, 0};
        const auto number = [&cdr](size_t value) {
            while (cdr.size() % 4 != 0) cdr.push_back(0);
            for (int shift = 0; shift < 32; shift += 8)
                cdr.push_back(static_cast<uint8_t>(value >> shift));
        };
        const auto string = [&](const std::string& text) {
            number(text.size() + 1);
            cdr.insert(cdr.end(), text.begin(), text.end());
            cdr.push_back(0);
        };
        const auto gid = [&](const rtps::GUID_t& guid) {
            Bytes bytes = guid_bytes(guid);
            bytes.resize(gid_length_);
            cdr.insert(cdr.end(), bytes.begin(), bytes.end());
        };
        gid(participant_->guid());
        number(name_.empty() ? 0 : 1);
        if (!name_.empty()) {
            string("/");
            string(name_);
            number(named_readers_.size());
            for (const auto& each : named_readers_) gid(each);
            number(named_writers_.size());
            for (const auto& each : named_writers_) gid(each);
        }
        graph_->writer->write(&cdr);
    }

    std::atomic<bool> over_{false};
    size_t gid_length_;
    std::string name_;
    fast::DomainParticipant* participant_ = nullptr;
    fast::Publisher* publisher_ = nullptr;
    fast::Subscriber* subscriber_ = nullptr;
    std::shared_ptr<Writer> graph_;
    std::vector<std::shared_ptr<Writer>> writers_;
    std::vector<std::shared_ptr<Reader>> readers_;
    std::vector<rtps::GUID_t> named_readers_, named_writers_;
    std::map<std::string, std::shared_ptr<Writer>> topics_;
    std::map<std::string, Client> clients_;
    std::vector<std::thread> publishing_;
};

int main(int argc, char** argv)
{
    if (argc < 5) {
        std::fprintf(stderr, "usage: %s DOMAIN default|whitelist|unicast 16|24 NODE [COMMAND...]\n",
            argv[0]);
        return 2;
    }
    try {
        Node node(std::stoul(argv[1]), argv[2], std::stoul(argv[3]), argv[4]);
        for (int i = 5; i < argc; ++i) node.obey(argv[i]);
        std::string line;
        while (std::getline(std::cin, line)) node.obey(line);
    } catch (const std::exception& error) {
        std::fprintf(stderr, "%s: %s\n", argv[0], error.what());
        return 1;
    }
    return 0;
}
